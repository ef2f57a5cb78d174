#include "clients/tactor_driver/driver_core.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace secondskin::tactor_driver {
namespace {

using wire::kSlotCount;

constexpr double kNever = std::numeric_limits<double>::infinity();
constexpr double kAbsurdLifetime = 10.0;  // somebody's milliseconds [s]
constexpr double kRefreshShare = 0.25;    // of a slow link's rate that refreshing may use
constexpr double kRetry = 0.002;          // after a port that takes nothing [s]
constexpr std::size_t kPair = 2;          // [bytes]
constexpr std::size_t kNone = kSlotCount;
/// The board may have given up on a torn pair's ID when its intensity comes this late.
constexpr double kTornTooLong = wire::CommandParser::kPairTimeout / 2.0;
/// Stands for "perhaps on, value not known": never wanted, so it is always due.
constexpr std::uint8_t kUncertain = 1;
static_assert(kUncertain < wire::kFaintestIntensity);

}  // namespace

DriverCore::DriverCore(double byte_rate)
    : byte_rate_(byte_rate),
      longest_backlog_(std::max<double>(kPair, byte_rate * kLongestBacklog)) {
  if (!(byte_rate > 0.0) || !std::isfinite(byte_rate)) {
    throw std::invalid_argument("tactor driver: the link's byte rate must be positive");
  }
}

Verdict DriverCore::push(const DriverCommand& command, double now) noexcept {
  lapse(now);
  if (stopped_) {
    ++counters_.refused_by_stop;
    return Verdict::kStopped;
  }
  if (!(command.valid_for > 0.0) || !(command.valid_for <= kAbsurdLifetime)) {
    ++counters_.bad_lifetimes;
    return Verdict::kBadLifetime;
  }
  if (commanded_ && command.number <= number_) {
    if (command.stamp_ns <= stamp_ns_) {
      ++counters_.old;
      return Verdict::kOld;
    }
    ++counters_.sender_restarts;
  }
  ++counters_.taken;
  commanded_ = true;
  number_ = command.number;
  stamp_ns_ = command.stamp_ns;
  lapses_at_ = now + std::min(command.valid_for, kLongestLifetime);

  wire::BoardState intensities = command.intensities;
  for (std::uint8_t& intensity : intensities) {
    if (intensity < wire::kFaintestIntensity) intensity = 0;
  }
  for (std::size_t group = 0; group < 4; ++group) {
    std::uint8_t& forward = intensities[wire::saltation_slot(group, false)];
    std::uint8_t& reverse = intensities[wire::saltation_slot(group, true)];
    if (forward != 0 && reverse != 0) {
      ++counters_.conflicts;
      (forward >= reverse ? reverse : forward) = 0;
    }
  }
  const bool was_on = wanted_on_ > 0;
  for (std::size_t i = 0; i < kSlotCount; ++i) want(i, intensities[i], now);
  if (!was_on && wanted_on_ > 0) silent_until_ = now;
  if (was_on && wanted_on_ == 0) all_off(now);
  return Verdict::kTaken;
}

void DriverCore::stop(bool active, double now) noexcept {
  if (active) {
    if (!stopped_) ++counters_.stops;
    commanded_ = false;
    all_off(now);
  }
  stopped_ = active;
}

void DriverCore::coach_lost(double now) noexcept {
  ++counters_.coach_losses;
  commanded_ = false;
  all_off(now);
}

void DriverCore::link_up(double now) noexcept {
  ++counters_.connections;
  linked_ = true;
  batch_size_ = 0;
  torn_ = kNone;
  backlog_ = 0.0;
  backlog_time_ = now;
  blocked_until_ = now;
  for (Slot& slot : slots_) {
    slot.must_write = slot.unknown = slot.repeat = true;
    slot.due_since = now;  // the same for all: the highest ID goes first, as encode_all_off() needs
  }
}

void DriverCore::link_down() noexcept {
  linked_ = false;
  batch_size_ = 0;
  torn_ = kNone;
}

void DriverCore::all_off(double now) noexcept {
  for (std::size_t i = 0; i < kSlotCount; ++i) {
    want(i, 0, now);
    if (!due(i)) slots_[i].due_since = now;
    slots_[i].must_write = slots_[i].repeat = true;
  }
}

void DriverCore::want(std::size_t index, std::uint8_t intensity, double now) noexcept {
  Slot& slot = slots_[index];
  if (wanted_[index] != intensity) {
    if (linked_ && wanted_[index] != slot.board) ++counters_.replaced;
    if (!due(index)) slot.due_since = now;
    if (wanted_[index] == 0) ++wanted_on_;
    if (intensity == 0) --wanted_on_;
    wanted_[index] = intensity;
  }
  if (intensity != 0 && !slot.unknown) slot.must_write = slot.repeat = false;
}

void DriverCore::lapse(double now) noexcept {
  if (!commanded_ || now < lapses_at_) return;
  ++counters_.lapses;
  commanded_ = false;
  all_off(now);
}

void DriverCore::drain(double now) noexcept {
  if (now > backlog_time_) {
    backlog_ = std::max(0.0, backlog_ - (now - backlog_time_) * byte_rate_);
    backlog_time_ = now;
  }
}

std::uint8_t DriverCore::target(std::size_t slot) const noexcept {
  return slots_[slot].unknown ? std::uint8_t{0} : wanted_[slot];
}

bool DriverCore::due(std::size_t slot) const noexcept {
  return slots_[slot].must_write || target(slot) != slots_[slot].board;
}

double DriverCore::refresh_period(std::size_t slot) const noexcept {
  const std::size_t sharing = wanted_[slot] != 0 ? wanted_on_ : kSlotCount;
  return std::max(kRefreshPeriod,
                  static_cast<double>(sharing * kPair) / byte_rate_ / kRefreshShare);
}

double DriverCore::refresh_at(std::size_t slot) const noexcept {
  return std::max(slots_[slot].last_sent, silent_until_) + refresh_period(slot);
}

std::size_t DriverCore::choose(double now) const noexcept {
  enum Class { kTurnOff, kRestOfAllOff, kValue, kNothing };
  std::size_t best = kNone;
  Class best_class = kNothing;
  double best_since = kNever;
  // From the last slot down: of equally old ones the highest ID first, ID 0 last.
  for (std::size_t i = kSlotCount; i-- > 0;) {
    const Slot& slot = slots_[i];
    Class its_class = kValue;
    double since = slot.due_since;
    if (due(i)) {
      if (target(i) == 0) its_class = slot.unknown || slot.board != 0 ? kTurnOff : kRestOfAllOff;
    } else {
      if (wanted_on_ == 0 && !slot.repeat) continue;
      if (now < refresh_at(i)) continue;
      since = refresh_at(i) + refresh_period(i);  // new values first, unless it is long overdue
    }
    if (its_class < best_class || (its_class == best_class && since < best_since)) {
      best = i;
      best_class = its_class;
      best_since = since;
    }
  }
  return best;
}

void DriverCore::mark_sent(std::size_t index, std::uint8_t bytes, double now) noexcept {
  Slot& slot = slots_[index];
  batch_[batch_size_++] = {index, slot, bytes};
  ++counters_.pairs;
  slot.board = target(index);
  if (slot.board == 0 && !slot.must_write) slot.repeat = false;
  slot.must_write = slot.unknown = false;
  slot.last_sent = now;
  slot.due_since = now;
}

std::size_t DriverCore::next_bytes(double now, std::span<std::uint8_t> out) noexcept {
  lapse(now);
  batch_size_ = 0;
  if (!linked_ || now < blocked_until_) return 0;
  drain(now);
  const double room = longest_backlog_ - backlog_ + 1e-6;  // rounding must not cost a pair
  if (room < kPair || out.size() < kPair) return 0;
  const std::size_t limit = std::min(out.size(), static_cast<std::size_t>(room));
  std::size_t count = 0;
  if (torn_ != kNone) {
    const std::size_t slot = torn_;
    torn_ = kNone;
    out[count++] = wire::encode(slot, target(slot))[1];
    mark_sent(slot, 1, now);
    if (now - torn_since_ > kTornTooLong) slots_[slot].board = kUncertain;  // once more, whole
  }
  while (count + kPair <= limit && batch_size_ < batch_.size()) {
    const std::size_t slot = choose(now);
    if (slot == kNone) break;
    const auto pair = wire::encode(slot, target(slot));
    out[count++] = pair[0];
    out[count++] = pair[1];
    mark_sent(slot, kPair, now);
  }
  backlog_ += static_cast<double>(count);
  counters_.bytes += count;
  return count;
}

void DriverCore::not_taken(std::size_t count, double now) noexcept {
  if (count == 0) return;
  blocked_until_ = now + kRetry;
  while (count > 0 && batch_size_ > 0) {
    const Sent& sent = batch_[--batch_size_];
    slots_[sent.slot] = sent.before;
    --counters_.pairs;
    const std::size_t lost = std::min<std::size_t>(count, sent.bytes);
    count -= lost;
    counters_.bytes -= lost;
    backlog_ = std::max(0.0, backlog_ - static_cast<double>(lost));
    if (sent.bytes == 1) {
      torn_ = sent.slot;  // still torn, since when it was
    } else if (lost == 1) {
      torn_ = sent.slot;
      torn_since_ = now;
    }
  }
}

void DriverCore::observe_backlog(std::size_t bytes, double now) noexcept {
  drain(now);
  backlog_ = std::max(backlog_, static_cast<double>(bytes));
  if (backlog_ > longest_backlog_) blocked_until_ = now + kRetry;
}

std::size_t DriverCore::pump(double now, wire::ByteLink& link) noexcept {
  std::array<std::uint8_t, 2 * kSlotCount + 2> bytes;
  observe_backlog(link.unsent(), now);
  const std::size_t count = next_bytes(now, bytes);
  if (count == 0) return 0;
  const std::size_t taken = link.write_some(std::span(bytes).first(count));
  not_taken(count - taken, now);
  return taken;
}

double DriverCore::next_due(double now) const noexcept {
  const double lapse_at = commanded_ ? lapses_at_ : kNever;
  if (!linked_) return std::max(now, lapse_at);
  double earliest = torn_ != kNone ? now : kNever;
  for (std::size_t i = 0; i < kSlotCount; ++i) {
    if (due(i)) {
      earliest = now;
      break;
    }
    if (wanted_on_ > 0 || slots_[i].repeat) {
      earliest = std::min(earliest, refresh_at(i));
    }
  }
  const double room_at =
      backlog_time_ + std::max(0.0, backlog_ + kPair - longest_backlog_) / byte_rate_;
  return std::max(now, std::min(lapse_at, std::max({earliest, room_at, blocked_until_})));
}

bool DriverCore::all_off_sent() const noexcept {
  if (!linked_) return true;
  if (wanted_on_ > 0 || torn_ != kNone) return false;
  for (std::size_t i = 0; i < kSlotCount; ++i) {
    if (due(i) || slots_[i].board != 0) return false;
  }
  return true;
}

}  // namespace secondskin::tactor_driver
