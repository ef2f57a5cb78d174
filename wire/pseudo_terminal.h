#pragma once

#include <string>

#include "wire/byte_link.h"

/// The device's side of a pseudo-terminal: what a simulated device holds in place of the wire's far
/// end. Bytes written to its path arrive here, and back. Raw; never waits; one thread at a time.
namespace secondskin::wire {

class PseudoTerminal final : public ByteLink {
 public:
  /// @param link_path  a symbolic link to create for it, so that the name can stay the same when
  /// the
  ///                   terminal goes and comes again; replaces an old link, nothing else
  /// @throws std::system_error, std::invalid_argument (link_path is a file that is no link)
  explicit PseudoTerminal(std::string link_path = {});
  /// Whoever has the path open is hung up. Removes the link if it is still this terminal's.
  ~PseudoTerminal() override;
  PseudoTerminal(const PseudoTerminal&) = delete;
  PseudoTerminal& operator=(const PseudoTerminal&) = delete;

  /// The terminal's own name, e.g. "/dev/pts/4".
  const std::string& slave_path() const noexcept { return slave_path_; }
  /// The name to give to users: the link if there is one.
  const std::string& path() const noexcept { return link_path_.empty() ? slave_path_ : link_path_; }
  /// For poll(2); the terminal keeps ownership. Does not hang up when the path's users close it.
  int fd() const noexcept { return fd_; }

  std::size_t write_some(std::span<const std::uint8_t> bytes) noexcept override;
  std::size_t read_some(std::span<std::uint8_t> bytes) noexcept override;
  bool connected() const noexcept override { return true; }

 private:
  void close() noexcept;

  int fd_ = -1;
  int slave_fd_ = -1;  ///< kept open: without it poll(2) would report a hang-up without end
  std::string slave_path_;
  std::string link_path_;
};

}  // namespace secondskin::wire
