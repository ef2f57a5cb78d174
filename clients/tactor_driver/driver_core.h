#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "wire/byte_link.h"
#include "wire/tactor_protocol.h"

/// What the tactor driver writes to the board, and when. Pure: no DDS, no threads, no clock; time
/// is passed in, monotonic [s]. No allocation after construction.
///
/// The board's forty slots are forty flags, never a queue: what goes out next is always the newest
/// value. In this order: turning off what may be on; the rest of an all-off; then new values and
/// refreshes, the one that waited longest first. While anything is on every slot is written again
/// within kRefreshPeriod, so that a lost or garbled byte is put right and the board's watchdog is
/// fed; once everything is off, every slot is written off twice, and the line falls silent.
namespace secondskin::tactor_driver {

/// The whole board for a while, as the coach sends it.
struct DriverCommand {
  wire::BoardState intensities{};
  std::int64_t stamp_ns = 0;  ///< when the sample that it follows from was measured [ns, epoch]
  double valid_for = 0.0;     ///< from its arrival [s]; at most kLongestLifetime is granted
  std::uint64_t number = 0;   ///< counts up at the sender
};

/// What became of a command.
enum class Verdict : std::uint8_t {
  kTaken,
  kOld,          ///< not newer than the one in force
  kStopped,      ///< a stop is in force
  kBadLifetime,  ///< valid_for is not a number, not positive, or absurd (over 10 s)
};

/// Each counts events since construction.
struct DriverCounters {
  std::uint64_t taken = 0;
  std::uint64_t old = 0;
  std::uint64_t refused_by_stop = 0;
  std::uint64_t bad_lifetimes = 0;
  std::uint64_t sender_restarts = 0;  ///< taken although the number went back: the stamp went on
  std::uint64_t conflicts = 0;  ///< both directions of one saltation asked for; the weaker dropped
  std::uint64_t replaced = 0;   ///< values that a newer one replaced before they were sent
  std::uint64_t lapses = 0;
  std::uint64_t stops = 0;
  std::uint64_t coach_losses = 0;
  std::uint64_t connections = 0;
  std::uint64_t pairs = 0;  ///< sent
  std::uint64_t bytes = 0;  ///< sent
};

class DriverCore {
 public:
  static constexpr double kLongestLifetime = 0.25;  ///< [s]
  static constexpr double kRefreshPeriod = 0.080;   ///< [s]; with a 7 ms sweep well under 100 ms
  static constexpr double kLongestBacklog =
      0.003;  ///< of the wire's time, in the port's buffer [s]

  /// @param byte_rate  of the link [1/s]: a tenth of the baud rate
  /// @throws std::invalid_argument if it is not positive
  explicit DriverCore(double byte_rate = 11'520.0);

  /// Takes a command; it replaces the one in force.
  Verdict push(const DriverCommand& command, double now) noexcept;
  /// Latched: everything goes off and commands are refused until stop(false), after which the next
  /// command is needed to turn anything on.
  void stop(bool active, double now) noexcept;
  /// The coach is gone: everything goes off; the next command is taken whatever its number.
  void coach_lost(double now) noexcept;

  /// The port was opened. What the board holds is unknown: all-off goes first, then the command in
  /// force.
  void link_up(double now) noexcept;
  void link_down() noexcept;

  /// Which bytes to write now: whole pairs (after not_taken() of an odd number: the missing half
  /// first), no more than the link's rate allows. They count as written.
  /// @returns how many were put into out; 0 if nothing is due
  std::size_t next_bytes(double now, std::span<std::uint8_t> out) noexcept;
  /// The port refused the last `count` bytes of the last next_bytes(); they become due again.
  void not_taken(std::size_t count, double now) noexcept;
  /// What waits on this side of the wire, where the port can tell: a stalled link must not fill up.
  void observe_backlog(std::size_t bytes, double now) noexcept;
  /// All of the above once, to this link. @returns how many bytes it took
  std::size_t pump(double now, wire::ByteLink& link) noexcept;

  /// When next_bytes() has something to do next if nothing else happens, at least now; infinity if
  /// never. A lapse counts.
  double next_due(double now) const noexcept;

  /// What the board should do now.
  const wire::BoardState& wanted() const noexcept { return wanted_; }
  bool stopped() const noexcept { return stopped_; }
  /// Whether a command is in force.
  bool commanded() const noexcept { return commanded_; }
  /// Whether the driver may end: every slot was written off and none is due, or there is no link.
  bool all_off_sent() const noexcept;
  const DriverCounters& counters() const noexcept { return counters_; }

 private:
  struct Slot {
    bool must_write = false;  ///< part of an all-off, or its last bytes may not have arrived
    bool unknown = false;     ///< since the link came up: may be on
    bool repeat = false;      ///< one more off after the all-off
    std::uint8_t board = 0;   ///< what the board holds if every byte arrived
    double due_since = 0.0;   ///< since when it differs from what is wanted, or must be written
    double last_sent = -1e9;  ///< [s]
  };
  struct Sent {
    std::size_t slot;
    Slot before;
    std::uint8_t bytes;  ///< of this pair in the last batch: 2, or 1 for a second half
  };

  void all_off(double now) noexcept;
  void want(std::size_t slot, std::uint8_t intensity, double now) noexcept;
  void lapse(double now) noexcept;
  void drain(double now) noexcept;
  std::size_t choose(double now) const noexcept;
  void mark_sent(std::size_t slot, std::uint8_t bytes, double now) noexcept;
  std::uint8_t target(std::size_t slot) const noexcept;
  bool due(std::size_t slot) const noexcept;
  double refresh_period(std::size_t slot) const noexcept;
  double refresh_at(std::size_t slot) const noexcept;

  double byte_rate_;
  double longest_backlog_;  ///< [bytes], at least one pair
  bool linked_ = false;
  bool stopped_ = false;
  bool commanded_ = false;
  std::uint64_t number_ = 0;
  std::int64_t stamp_ns_ = 0;
  double lapses_at_ = 0.0;
  wire::BoardState wanted_{};
  std::size_t wanted_on_ = 0;   ///< slots that are wanted on
  double silent_until_ = -1e9;  ///< when something was wanted on again; refreshing counts from here
  std::array<Slot, wire::kSlotCount> slots_{};
  std::array<Sent, wire::kSlotCount + 1> batch_{};
  std::size_t batch_size_ = 0;
  std::size_t torn_ = wire::kSlotCount;  ///< slot whose ID went out without its intensity
  double torn_since_ = 0.0;
  double backlog_ = 0.0;  ///< bytes that the port has taken and the wire has not carried yet
  double backlog_time_ = 0.0;
  double blocked_until_ = 0.0;
  DriverCounters counters_;
};

}  // namespace secondskin::tactor_driver
