#include "clients/tactor_driver/driver_core.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "sim/board/virtual_board.h"

namespace secondskin::tactor_driver {
namespace {

using wire::BoardState;
using wire::encode;
using wire::kSlotCount;

constexpr double kNever = std::numeric_limits<double>::infinity();
constexpr double kNotANumber = std::numeric_limits<double>::quiet_NaN();
constexpr BoardState kAllOff{};

struct Arrival {
  double time;
  std::uint8_t byte;
};

/// A wire of a given speed behind a buffer that takes a lot.
class SlowWire final : public wire::ByteLink {
 public:
  explicit SlowWire(double byte_rate) : byte_rate_(byte_rate) {}

  std::size_t write_some(std::span<const std::uint8_t> bytes) noexcept override {
    if (stalled) return 0;
    std::size_t count = std::min(bytes.size(), takes_at_most);
    for (const std::uint8_t byte : bytes.first(count)) {
      free_at_ = std::max(free_at_, now) + 1.0 / byte_rate_;
      queue_.push_back({free_at_, byte});
    }
    longest_wait = std::max(longest_wait, free_at_ - now);
    return count;
  }
  std::size_t read_some(std::span<std::uint8_t>) noexcept override { return 0; }
  bool connected() const noexcept override { return true; }
  std::size_t unsent() const noexcept override { return reported_unsent; }

  /// What has come out at the far end by now.
  std::vector<Arrival> arrived() {
    std::vector<Arrival> out;
    while (!queue_.empty() && queue_.front().time <= now) {
      out.push_back(queue_.front());
      queue_.pop_front();
    }
    return out;
  }

  double now = 0.0;
  bool stalled = false;
  std::size_t takes_at_most = 1'000'000;
  std::size_t reported_unsent = 0;
  double longest_wait = 0.0;  ///< from write to the far end, of the last byte [s]

 private:
  double byte_rate_;
  double free_at_ = 0.0;
  std::deque<Arrival> queue_;
};

DriverCommand command(std::uint64_t number, const BoardState& intensities, double valid_for = 0.1) {
  return {intensities, static_cast<std::int64_t>(number) * 16'000'000, valid_for, number};
}

BoardState only(std::size_t slot, std::uint8_t intensity) {
  BoardState state{};
  state[slot] = intensity;
  return state;
}

/// Any board that a coach may ask for: mostly off, never both directions of one saltation.
BoardState random_board(std::mt19937& random) {
  std::uniform_int_distribution<int> percent(0, 99);
  std::uniform_int_distribution<int> intensity(54, 255);
  BoardState state{};
  for (std::uint8_t& slot : state) {
    if (percent(random) < 20) slot = static_cast<std::uint8_t>(intensity(random));
  }
  for (std::size_t group = 0; group < 4; ++group) {
    if (state[wire::saltation_slot(group, true)] != 0) {
      state[wire::saltation_slot(group, false)] = 0;
    }
  }
  return state;
}

/// Pumps until a time, as the service does: whenever something is due.
void run_until(DriverCore& core, SlowWire& wire, double end, std::vector<Arrival>* log = nullptr) {
  for (int guard = 0; guard < 10'000'000; ++guard) {
    core.pump(wire.now, wire);
    if (log != nullptr) {
      for (const Arrival& arrival : wire.arrived()) log->push_back(arrival);
    }
    // A timer that is late by some tens of microseconds.
    const double next = std::max(core.next_due(wire.now), wire.now) + 50e-6;
    if (next > end) break;
    wire.now = next;
  }
  wire.now = end;
  if (log != nullptr) {
    for (const Arrival& arrival : wire.arrived()) log->push_back(arrival);
  }
}

std::vector<std::uint8_t> bytes_of(const std::vector<Arrival>& log) {
  std::vector<std::uint8_t> bytes;
  for (const Arrival& arrival : log) bytes.push_back(arrival.byte);
  return bytes;
}

/// The driver after its first all-off, at time 1, silent.
struct Ready {
  explicit Ready(double byte_rate = 11'520.0) : core(byte_rate), wire(byte_rate) {
    core.link_up(0.0);
    run_until(core, wire, 10.0);
    wire.arrived();
    wire.longest_wait = 0.0;
  }
  DriverCore core;
  SlowWire wire;
};

BoardState board_after(const std::vector<Arrival>& log, BoardState before = {}) {
  wire::BoardPatterns board;
  for (std::size_t slot = 0; slot < kSlotCount; ++slot) board.apply({slot, before[slot]}, 0.0);
  wire::CommandParser parser;
  for (const Arrival& arrival : log) {
    if (const auto c = parser.push(arrival.byte, arrival.time)) board.apply(*c, arrival.time);
  }
  return board.state();
}

TEST(DriverCore, BeginsAConnectionWithAllOffFromTheHighestId) {
  DriverCore core;
  SlowWire wire(11'520.0);
  core.push(command(1, only(7, 200), 0.25), 0.0);
  core.link_up(0.0);
  std::vector<Arrival> log;
  run_until(core, wire, 0.050, &log);
  const auto bytes = bytes_of(log);
  const auto all_off = wire::encode_all_off();
  ASSERT_EQ(bytes.size(), 82U);
  EXPECT_TRUE(std::equal(all_off.begin(), all_off.end(), bytes.begin()));
  EXPECT_LT(log[79].time, 0.0075);  // 7 ms at 115,200 baud
  EXPECT_EQ(bytes[80], wire::id_of_slot(7));
  EXPECT_EQ(bytes[81], 200);  // then the command in force
}

TEST(DriverCore, WritesNothingBeforeALinkAndNothingAfterItIsLost) {
  DriverCore core;
  std::array<std::uint8_t, 100> out;
  core.push(command(1, only(7, 200)), 0.0);
  EXPECT_EQ(core.next_bytes(0.0, out), 0U);
  EXPECT_EQ(core.next_due(0.0), 0.1);  // only the lapse
  core.link_up(0.0);
  EXPECT_GT(core.next_bytes(0.0, out), 0U);
  core.link_down();
  EXPECT_EQ(core.next_bytes(0.01, out), 0U);
  EXPECT_TRUE(core.all_off_sent());  // nothing that could be done
}

TEST(DriverCore, SendsAChangedSlotAtOnceAndAlone) {
  Ready ready;
  EXPECT_EQ(ready.core.next_due(10.0), kNever);
  ASSERT_EQ(ready.core.push(command(1, only(12, 77)), 10.0), Verdict::kTaken);
  std::array<std::uint8_t, 100> out;
  ASSERT_EQ(ready.core.next_bytes(10.0, out), 2U);
  EXPECT_EQ(out[0], wire::id_of_slot(12));
  EXPECT_EQ(out[1], 77);
  EXPECT_EQ(ready.core.next_bytes(10.0, out), 0U);
}

TEST(DriverCore, TurnsOffBeforeItTurnsOn) {
  Ready ready;
  BoardState state = only(20, 200);
  ready.core.push(command(1, state), 10.0);
  run_until(ready.core, ready.wire, 10.01);
  ready.wire.arrived();
  state.fill(0);
  for (std::size_t slot = 0; slot < 8; ++slot) state[slot] = 100;
  ready.core.push(command(2, state), 10.01);
  std::array<std::uint8_t, 100> out;
  ASSERT_GE(ready.core.next_bytes(10.01, out), 4U);
  EXPECT_EQ(out[0], wire::id_of_slot(20));
  EXPECT_EQ(out[1], 0);
  EXPECT_EQ(out[3], 100);
}

TEST(DriverCore, SendsTheNewestValueAndNeverAnOlderUnsentOne) {
  Ready ready(120.0);  // 1,200 baud: 60 pairs a second, for 1,000 changes a second
  std::vector<Arrival> log;
  std::vector<BoardState> pushed;
  for (int n = 0; n < 125; ++n) {  // two seconds at 62.5 Hz
    BoardState state{};
    for (std::size_t tactor = 0; tactor < 16; ++tactor) {
      state[wire::continuous_slot(tactor)] = static_cast<std::uint8_t>(60 + n);
    }
    const double now = 10.0 + n * 0.016;
    ASSERT_EQ(ready.core.push(command(static_cast<std::uint64_t>(n) + 1, state), now),
              Verdict::kTaken);
    pushed.push_back(state);
    run_until(ready.core, ready.wire, now + 0.016, &log);
  }
  wire::CommandParser parser;
  std::vector<int> last(kSlotCount, -1);
  for (const Arrival& arrival : log) {
    const auto c = parser.push(arrival.byte, arrival.time);
    if (!c || c->intensity == 0) continue;
    const int newest = static_cast<int>((arrival.time - 10.0) / 0.016);
    // On the wire for two bytes, 17 ms: no older than the newest but two.
    EXPECT_GE(c->intensity - 60, newest - 2);
    EXPECT_GE(int{c->intensity}, last[c->slot]);
    last[c->slot] = c->intensity;
  }
  for (std::size_t tactor = 0; tactor < 16; ++tactor) {
    EXPECT_GT(last[wire::continuous_slot(tactor)], 60 + 90) << "tactor " << tactor << " starved";
  }
  EXPECT_LE(ready.wire.longest_wait, 2.0 / 120.0 + 1e-3);  // never more than a pair queued
  EXPECT_GT(ready.core.counters().replaced, 500U);
}

TEST(DriverCore, KeepsTheBacklogUnderAFewMillisecondsAtAnySpeed) {
  std::mt19937 random(1);
  for (const double byte_rate : {120.0, 960.0, 11'520.0, 92'160.0}) {
    Ready ready(byte_rate);
    for (int n = 0; n < 200; ++n) {
      const double now = 10.0 + n * 0.004;
      ready.core.push(command(static_cast<std::uint64_t>(n) + 1, random_board(random)), now);
      run_until(ready.core, ready.wire, now + 0.004);
      ready.wire.arrived();
    }
    EXPECT_LE(ready.wire.longest_wait, std::max(0.003, 2.0 / byte_rate) + 1e-3) << byte_rate;
  }
}

TEST(DriverCore, RefreshesEverySlotWithinATenthOfASecondWhileAnythingIsOn) {
  Ready ready;
  std::vector<Arrival> log;
  const BoardState state = only(3, 120);
  for (int n = 0; n < 125; ++n) {
    const double now = 10.0 + n * 0.016;
    ready.core.push(command(static_cast<std::uint64_t>(n) + 1, state), now);
    run_until(ready.core, ready.wire, now + 0.016, &log);
  }
  std::array<double, kSlotCount> last;
  last.fill(10.0);
  double last_byte = 10.0;
  wire::CommandParser parser;
  for (const Arrival& arrival : log) {
    EXPECT_LT(arrival.time - last_byte, 0.1);  // the board's watchdog waits 0.25 s
    last_byte = arrival.time;
    if (const auto c = parser.push(arrival.byte, arrival.time)) {
      EXPECT_LT(arrival.time - last[c->slot], 0.1) << "slot " << c->slot;
      last[c->slot] = arrival.time;
      EXPECT_EQ(c->intensity, state[c->slot]);
    }
  }
  for (const double time : last) EXPECT_GT(time, 12.0 - 0.1);
  // And costs little of the line: 80 bytes in 80 ms.
  EXPECT_LT(log.size(), 2.0 * 1'100);
}

TEST(DriverCore, FeedsTheWatchdogOfASlowLinkToo) {
  Ready ready(120.0);
  sim::VirtualBoard board({}, 10.0);
  for (int n = 0; n < 125; ++n) {
    const double now = 10.0 + n * 0.016;
    BoardState state = only(3, 120);
    state[30] = 200;
    ready.core.push(command(static_cast<std::uint64_t>(n) + 1, state), now);
    std::vector<Arrival> log;
    run_until(ready.core, ready.wire, now + 0.016, &log);
    for (const Arrival& arrival : log) board.receive(std::array{arrival.byte}, arrival.time);
    if (n <= 10) continue;
    EXPECT_EQ(board.state(), state);
  }
  EXPECT_EQ(board.counters().watchdog_trips, 0U);
}

TEST(DriverCore, TurnsEverythingOffWhenTheCommandLapses) {
  Ready ready;
  BoardState state = only(0, 200);
  state[39] = 100;
  ready.core.push(command(1, state, 0.06), 10.0);
  std::vector<Arrival> log;
  run_until(ready.core, ready.wire, 10.0599, &log);
  EXPECT_EQ(board_after(log), state);
  EXPECT_DOUBLE_EQ(ready.core.next_due(10.0599), 10.06);
  log.clear();
  run_until(ready.core, ready.wire, 10.0675, &log);
  EXPECT_EQ(ready.core.counters().lapses, 1U);
  ASSERT_EQ(log.size(), 80U);                    // the whole board
  EXPECT_EQ(log[0].byte, wire::id_of_slot(39));  // what was on, first
  EXPECT_EQ(log[2].byte, wire::id_of_slot(0));
  EXPECT_EQ(board_after(log, state), kAllOff);
  EXPECT_TRUE(ready.core.all_off_sent());
}

TEST(DriverCore, RepeatsAnAllOffOnceAndFallsSilent) {
  Ready ready;
  ready.core.push(command(1, only(5, 200), 0.05), 10.0);
  run_until(ready.core, ready.wire, 10.05);
  ready.wire.arrived();
  std::vector<Arrival> log;
  run_until(ready.core, ready.wire, 60.0, &log);
  EXPECT_EQ(log.size(), 160U);
  EXPECT_LT(log.back().time, 10.05 + 0.1);
  EXPECT_EQ(ready.core.next_due(60.0), kNever);
}

TEST(DriverCore, SendsTheWholeAllOffWhenACommandTurnsTheLastSlotOff) {
  Ready ready;
  ready.core.push(command(1, only(5, 200)), 10.0);
  run_until(ready.core, ready.wire, 10.01);
  ready.wire.arrived();
  ready.core.push(command(2, kAllOff), 10.01);
  std::vector<Arrival> log;
  run_until(ready.core, ready.wire, 10.05, &log);
  EXPECT_EQ(log.size(), 80U);
  EXPECT_EQ(log[0].byte, wire::id_of_slot(5));
}

TEST(DriverCore, StaysStoppedUntilTheStopIsCleared) {
  Ready ready;
  ready.core.push(command(1, only(5, 200)), 10.0);
  run_until(ready.core, ready.wire, 10.01);
  ready.wire.arrived();
  ready.core.stop(true, 10.01);
  std::array<std::uint8_t, 4> out;
  ASSERT_EQ(ready.core.next_bytes(10.01, out), 4U);
  EXPECT_EQ(out[0], wire::id_of_slot(5));
  EXPECT_EQ(out[1], 0);
  EXPECT_EQ(ready.core.push(command(2, only(5, 200)), 10.02), Verdict::kStopped);
  EXPECT_EQ(ready.core.wanted(), kAllOff);
  ready.core.stop(false, 10.03);
  EXPECT_EQ(ready.core.wanted(), kAllOff);  // a new command is needed
  EXPECT_EQ(ready.core.push(command(3, only(5, 200)), 10.04), Verdict::kTaken);
  EXPECT_EQ(ready.core.wanted()[5], 200);
  EXPECT_EQ(ready.core.counters().refused_by_stop, 1U);
  EXPECT_EQ(ready.core.counters().stops, 1U);
}

TEST(DriverCore, TurnsEverythingOffWhenTheCoachIsLostAndTakesTheNextOne) {
  Ready ready;
  ready.core.push(command(1000, only(5, 200), 0.25), 10.0);
  ready.core.coach_lost(10.01);
  EXPECT_EQ(ready.core.wanted(), kAllOff);
  EXPECT_FALSE(ready.core.commanded());
  EXPECT_EQ(ready.core.push(command(1, only(6, 100)), 10.02), Verdict::kTaken);
  EXPECT_EQ(ready.core.wanted()[6], 100);
}

TEST(DriverCore, DropsOldCommandsAndKnowsARestartedSender) {
  Ready ready;
  DriverCommand c = command(10, only(5, 200), 0.25);
  EXPECT_EQ(ready.core.push(c, 10.0), Verdict::kTaken);
  EXPECT_EQ(ready.core.push(c, 10.001), Verdict::kOld);  // twice
  c.number = 9;
  c.stamp_ns -= 16'000'000;
  EXPECT_EQ(ready.core.push(c, 10.002), Verdict::kOld);  // overtaken
  EXPECT_EQ(ready.core.counters().old, 2U);
  c.number = 1;
  c.stamp_ns += 160'000'000;
  EXPECT_EQ(ready.core.push(c, 10.003), Verdict::kTaken);  // counts from 1 again, later stamp
  EXPECT_EQ(ready.core.counters().sender_restarts, 1U);
}

TEST(DriverCore, DoesNotLetAnOldCommandProlongTheOneInForce) {
  Ready ready;
  const DriverCommand c = command(10, only(5, 200), 0.05);
  ready.core.push(c, 10.0);
  for (double now = 10.01; now < 10.05; now += 0.01) {
    EXPECT_EQ(ready.core.push(c, now), Verdict::kOld);
  }
  run_until(ready.core, ready.wire, 10.051);
  EXPECT_EQ(ready.core.wanted(), kAllOff);
}

TEST(DriverCore, RefusesLifetimesThatAreNoneAndCapsLongOnes) {
  for (const double lifetime : {kNotANumber, -1.0, 0.0, kNever, -kNever, 50.0}) {
    Ready ready;
    EXPECT_EQ(ready.core.push(command(1, only(5, 200), lifetime), 10.0), Verdict::kBadLifetime);
    EXPECT_EQ(ready.core.wanted(), kAllOff);
    EXPECT_EQ(ready.core.counters().bad_lifetimes, 1U);
  }
  Ready ready;
  EXPECT_EQ(ready.core.push(command(1, only(5, 200), 2.0), 10.0), Verdict::kTaken);
  run_until(ready.core, ready.wire, 10.249);
  EXPECT_EQ(ready.core.wanted()[5], 200);
  run_until(ready.core, ready.wire, 10.251);
  EXPECT_EQ(ready.core.wanted(), kAllOff);
}

TEST(DriverCore, SendsTheStrongerOfTwoSaltationDirectionsOfAGroup) {
  Ready ready;
  BoardState state{};
  state[wire::saltation_slot(2, false)] = 100;
  state[wire::saltation_slot(2, true)] = 200;
  ready.core.push(command(1, state), 10.0);
  EXPECT_EQ(ready.core.wanted()[wire::saltation_slot(2, false)], 0);
  EXPECT_EQ(ready.core.wanted()[wire::saltation_slot(2, true)], 200);
  EXPECT_EQ(ready.core.counters().conflicts, 1U);
}

TEST(DriverCore, NeverEmitsTheIntensitiesThatCannotBe) {
  std::mt19937 random(2);
  std::uniform_int_distribution<int> any(0, 255);
  Ready ready;
  std::vector<Arrival> log;
  for (int n = 0; n < 500; ++n) {
    BoardState state;
    for (std::uint8_t& slot : state) slot = static_cast<std::uint8_t>(any(random));
    const double now = 10.0 + n * 0.01;
    ready.core.push(command(static_cast<std::uint64_t>(n) + 1, state), now);
    run_until(ready.core, ready.wire, now + 0.01, &log);
  }
  ASSERT_EQ(log.size() % 2, 0U);
  for (std::size_t i = 0; i < log.size(); i += 2) {
    ASSERT_TRUE(wire::slot_of_id(log[i].byte));
    const std::uint8_t intensity = log[i + 1].byte;
    ASSERT_TRUE(intensity == 0 || intensity >= wire::kFaintestIntensity) << int{intensity};
  }
}

TEST(DriverCore, BringsTheBoardToWhatIsWantedHoweverTheLinkTearsPairs) {
  std::mt19937 random(3);
  std::uniform_int_distribution<std::size_t> some(0, 5);
  Ready ready;
  std::vector<Arrival> log;
  std::array<std::vector<std::uint8_t>, kSlotCount> asked;  // values asked for, newest last
  BoardState state{};
  for (int n = 0; n < 1000; ++n) {
    const double now = 10.0 + n * 0.016;
    if (n % 10 == 0) state = random_board(random);
    for (std::size_t slot = 0; slot < kSlotCount; ++slot) asked[slot].push_back(state[slot]);
    ready.core.push(command(static_cast<std::uint64_t>(n) + 1, state, 0.2), now);
    for (int k = 0; k < 8; ++k) {
      ready.wire.takes_at_most = some(random);
      run_until(ready.core, ready.wire, now + (k + 1) * 0.002, &log);
    }
    if (n % 10 == 9) {
      ready.wire.takes_at_most = 1'000'000;
      run_until(ready.core, ready.wire, now + 0.0161, &log);
      ASSERT_EQ(board_after(log), state) << "after " << n;
    }
  }
  wire::CommandParser parser;
  for (const Arrival& arrival : log) {
    const auto c = parser.push(arrival.byte, arrival.time);
    if (!c || c->intensity == 0) continue;
    const auto newest = static_cast<std::size_t>((arrival.time - 10.0) / 0.016);
    const auto& values = asked[c->slot];
    const auto from = values.begin() + static_cast<long>(newest > 3 ? newest - 3 : 0);
    const auto to = values.begin() + static_cast<long>(std::min(newest + 1, values.size()));
    ASSERT_NE(std::find(from, to, c->intensity), to) << "slot " << c->slot;
  }
}

TEST(DriverCore, WritesNothingMoreIntoALinkThatHasStalledAndDoesNotSpin) {
  Ready ready;
  ready.core.push(command(1, only(5, 200), 0.25), 10.0);
  run_until(ready.core, ready.wire, 10.01);
  ready.wire.reported_unsent = 500;  // the adapter has lost the board and fills up
  const std::uint64_t before = ready.core.counters().bytes;
  int pumps = 0;
  for (double now = 10.01; now < 10.2; now = std::max(now, ready.core.next_due(now))) {
    ready.wire.now = now;
    EXPECT_EQ(ready.core.pump(now, ready.wire), 0U);
    ASSERT_LT(++pumps, 200);
  }
  EXPECT_EQ(ready.core.counters().bytes, before);
  ready.wire.reported_unsent = 0;
  ready.wire.stalled = true;  // takes nothing at all
  pumps = 0;
  for (double now = 10.2; now < 10.4; now = std::max(now, ready.core.next_due(now))) {
    ready.wire.now = now;
    EXPECT_EQ(ready.core.pump(now, ready.wire), 0U);
    ASSERT_LT(++pumps, 200);
  }
  EXPECT_EQ(ready.core.counters().bytes, before);
  ready.wire.stalled = false;
  std::vector<Arrival> log;
  run_until(ready.core, ready.wire, 10.41, &log);
  EXPECT_EQ(board_after(log, only(5, 200)), kAllOff);  // it has lapsed meanwhile
}

TEST(DriverCore, RefusesALinkWithoutSpeed) {
  EXPECT_THROW(DriverCore(0.0), std::invalid_argument);
  EXPECT_THROW(DriverCore{kNotANumber}, std::invalid_argument);
}

/// A second of random commands at 62.5 Hz, each board held for 80 ms, then the lapse.
std::vector<Arrival> session(unsigned seed) {
  std::mt19937 random(seed);
  Ready ready;
  std::vector<Arrival> log;
  BoardState state{};
  for (int n = 0; n < 62; ++n) {
    const double now = 10.0 + n * 0.016;
    if (n % 5 == 0) state = random_board(random);
    ready.core.push(command(static_cast<std::uint64_t>(n) + 1, state), now);
    run_until(ready.core, ready.wire, now + 0.016, &log);
  }
  run_until(ready.core, ready.wire, 11.5, &log);
  return log;
}

/// Plays a stream and a damaged one to two boards. From `repair` after the damage they must agree,
/// and at the end, when the board's watchdog has come too, all must be off.
/// @returns how many non-zero commands only the damaged board took
std::size_t compare(const std::vector<Arrival>& clean, const std::vector<Arrival>& damaged,
                    double damage_time, double repair) {
  struct Change {
    double time;
    wire::Command command;
  };
  const auto parse = [](const std::vector<Arrival>& log) {
    wire::CommandParser parser;
    std::vector<Change> changes;
    for (const Arrival& arrival : log) {
      if (const auto c = parser.push(arrival.byte, arrival.time)) {
        changes.push_back({arrival.time, *c});
      }
    }
    return changes;
  };
  const std::vector<Change> a = parse(clean);
  const std::vector<Change> b = parse(damaged);
  BoardState board_a{};
  BoardState board_b{};
  std::size_t i = 0;
  std::size_t k = 0;
  std::size_t uncommanded = 0;
  while (i < a.size() || k < b.size()) {
    const double time =
        std::min(i < a.size() ? a[i].time : kNever, k < b.size() ? b[k].time : kNever);
    while (i < a.size() && a[i].time <= time) {
      board_a[a[i].command.slot] = a[i].command.intensity;
      ++i;
    }
    while (k < b.size() && b[k].time <= time) {
      const wire::Command& c = b[k].command;
      const bool known = i > 0 && a[i - 1].time == b[k].time && a[i - 1].command.slot == c.slot &&
                         a[i - 1].command.intensity == c.intensity;
      if (!known && c.intensity != 0) ++uncommanded;
      board_b[c.slot] = c.intensity;
      ++k;
    }
    if (time >= damage_time + repair) {
      EXPECT_EQ(board_a, board_b) << time - damage_time << " s after the damage";
      if (board_a != board_b) return uncommanded;
    }
  }
  if (clean.back().time >= damage_time + repair) {
    EXPECT_EQ(board_b, kAllOff);
    return uncommanded;
  }
  // What is damaged in the last repetition of the all-off is the watchdog's: the line is silent.
  sim::VirtualBoard board({}, 10.0);
  for (const Arrival& arrival : damaged) board.receive(std::array{arrival.byte}, arrival.time);
  board.step(clean.back().time + wire::kBoardWatchdog);
  EXPECT_EQ(board.state(), kAllOff);
  return uncommanded;
}

TEST(DriverStream, IsPutRightWithinATenthOfASecondAfterALostByteAndDrivesNothingUncommanded) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    const std::vector<Arrival> clean = session(seed);
    ASSERT_GT(clean.size(), 1000U);
    for (std::size_t lost = 0; lost < clean.size(); ++lost) {
      std::vector<Arrival> damaged = clean;
      damaged.erase(damaged.begin() + static_cast<long>(lost));
      ASSERT_EQ(compare(clean, damaged, clean[lost].time, 0.1), 0U) << "byte " << lost;
      ASSERT_FALSE(HasFailure()) << "byte " << lost;
    }
  }
}

TEST(DriverStream, IsPutRightWithinATenthOfASecondAfterAGarbledByteThatSetOneSlotWrong) {
  std::mt19937 random(4);
  std::uniform_int_distribution<int> any(0, 255);
  const std::vector<Arrival> clean = session(4);
  for (std::size_t at = 0; at < clean.size(); ++at) {
    std::vector<Arrival> damaged = clean;
    damaged[at].byte = static_cast<std::uint8_t>(any(random));
    ASSERT_LE(compare(clean, damaged, clean[at].time, 0.1), 1U) << "byte " << at;
    ASSERT_FALSE(HasFailure()) << "byte " << at << " as " << int{damaged[at].byte};
  }
}

}  // namespace
}  // namespace secondskin::tactor_driver
