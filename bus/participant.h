#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

/// A program's place on the bus. Everything else in this folder hangs on one.
///
/// Default reach is this machine: UDP on 127.0.0.1, discovery by unicast, so no packet leaves.
/// Never shared memory: a program that is killed can hold up those that send to it for good
/// (docs/architecture.md, Topics). The subject is the person who learns; it is part of every
/// topic's name.
namespace secondskin::bus {

enum class Reach : std::uint8_t { kThisMachine, kNetwork };

struct Config {
  std::string subject = "learner";  ///< letters, digits and '_'; it names the topics
  std::uint32_t domain = 0;         ///< DDS domain, 0 to 232
  Reach reach = Reach::kThisMachine;
  std::filesystem::path qos_file;   ///< idl/qos.xml
  std::string name = "secondskin";  ///< of this program, for others to see
};

/// Wall clock [ns since the Unix epoch], as message stamps have it.
std::int64_t now_ns() noexcept;

class Participant {
 public:
  /// Joins the domain.
  /// @throws std::runtime_error naming what could not be made and what to try.
  explicit Participant(const Config& config);
  ~Participant();  ///< after all its writers and readers
  Participant(const Participant&) = delete;
  Participant& operator=(const Participant&) = delete;

  const Config& config() const noexcept;

  struct Entities;
  Entities& entities() noexcept { return *entities_; }

 private:
  std::unique_ptr<Entities> entities_;
};

}  // namespace secondskin::bus
