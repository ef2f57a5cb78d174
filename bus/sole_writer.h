#pragma once

#include <chrono>
#include <string_view>

#include "bus/reader.h"
#include "bus/wait_set.h"

namespace secondskin::bus {

/// A lock that one process of this machine holds for a subject in a domain, until it ends in any
/// way.
class SoleLock {
 public:
  /// @param role  in words, e.g. "capture server"
  /// @throws std::runtime_error naming role, subject, domain and the process that holds it.
  SoleLock(const Config& config, std::string_view role);
  ~SoleLock();
  SoleLock(const SoleLock&) = delete;
  SoleLock& operator=(const SoleLock&) = delete;

  [[noreturn]] static void refuse(const Config& config, std::string_view role,
                                  std::string_view who);

 private:
  int fd_ = -1;
};

/// Makes sure that a participant is the only one to write a topic of its subject: two capture
/// servers or two coaches would contradict each other. On this machine a lock tells at once; on a
/// network discovery does, for which a second is allowed at the start.
template <TopicMessage Message>
class SoleWriter {
 public:
  /// Make it after the participant's own writer of the topic. @throws std::runtime_error as
  /// SoleLock.
  SoleWriter(Participant& participant, std::string_view role)
      : lock_(participant.config(), role), reader_(participant) {
    if (participant.config().reach != Reach::kNetwork) return;
    using Clock = std::chrono::steady_clock;
    WaitSet news;
    news.attach(reader_);
    const auto end = Clock::now() + std::chrono::seconds(1);
    for (auto now = Clock::now(); now < end && !another(); now = Clock::now()) {
      news.wait(end - now);
      take_all();
    }
    if (another()) SoleLock::refuse(participant.config(), role, "on the network");
  }

  /// Whether somebody else has come since.
  bool another() const noexcept { return reader_.counts().writers > 1; }

 private:
  void take_all() noexcept {
    Message ignored;
    reader_.take_newest(ignored);
  }

  SoleLock lock_;
  Reader<Message> reader_;
};

}  // namespace secondskin::bus
