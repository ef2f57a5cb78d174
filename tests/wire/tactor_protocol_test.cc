#include "wire/tactor_protocol.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include "wire/tactor_waveform.h"

namespace secondskin::wire {
namespace {

constexpr double kByteTime = 10.0 / 115'200.0;
constexpr BoardState kAllOff{};

/// The section's list, written out.
std::vector<int> ids_of_section_4_2() {
  return {0,  1,  2,  3,  4,  5,  6,  7,  10, 11, 12, 13, 14, 15, 16, 17, 20, 21, 22, 23,
          30, 31, 32, 33, 34, 35, 36, 37, 40, 41, 42, 43, 44, 45, 46, 47, 50, 51, 52, 53};
}

struct Numbered {
  std::size_t at;  ///< index of the byte that completed the command
  Command command;
};

std::vector<Numbered> parse(const std::vector<std::uint8_t>& bytes) {
  CommandParser parser;
  std::vector<Numbered> commands;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    if (const auto command = parser.push(bytes[i], static_cast<double>(i) * kByteTime)) {
      commands.push_back({i, *command});
    }
  }
  return commands;
}

BoardPatterns everything_on() {
  BoardPatterns board;
  for (std::size_t slot = 0; slot < kSlotCount; ++slot) board.apply({slot, 200}, 0.0);
  return board;
}

/// A stream as the driver makes it: valid IDs, intensities of 0 or 54 to 255.
std::vector<std::uint8_t> random_stream(std::mt19937& random, std::size_t pairs) {
  std::uniform_int_distribution<std::size_t> slot(0, kSlotCount - 1);
  std::uniform_int_distribution<int> intensity(0, 255);
  std::vector<std::uint8_t> bytes;
  for (std::size_t i = 0; i < pairs; ++i) {
    for (const std::uint8_t byte :
         encode(slot(random), static_cast<std::uint8_t>(intensity(random)))) {
      bytes.push_back(byte);
    }
  }
  return bytes;
}

/// How many non-zero commands the damaged stream has that the clean one has not.
std::size_t uncommanded(const std::vector<Numbered>& clean, const std::vector<Numbered>& damaged,
                        std::size_t damage_at, int shift) {
  std::size_t count = 0;
  for (const Numbered& d : damaged) {
    if (d.command.intensity == 0) continue;
    const bool known = std::any_of(clean.begin(), clean.end(), [&](const Numbered& c) {
      const auto at = static_cast<long>(d.at) - (d.at >= damage_at ? shift : 0);
      return static_cast<long>(c.at) == at && c.command.slot == d.command.slot &&
             c.command.intensity == d.command.intensity;
    });
    if (!known) ++count;
  }
  return count;
}

TEST(TactorProtocol, HasTheIdsOfSection42InOrder) {
  const std::vector<int> ids = ids_of_section_4_2();
  ASSERT_EQ(ids.size(), kSlotCount);
  for (std::size_t slot = 0; slot < kSlotCount; ++slot) EXPECT_EQ(id_of_slot(slot), ids[slot]);
}

TEST(TactorProtocol, KnowsNoOtherIds) {
  const std::vector<int> ids = ids_of_section_4_2();
  for (int id = 0; id < 256; ++id) {
    const auto slot = slot_of_id(static_cast<std::uint8_t>(id));
    const auto found = std::find(ids.begin(), ids.end(), id);
    ASSERT_EQ(slot.has_value(), found != ids.end()) << "ID " << id;
    if (!slot) continue;
    EXPECT_EQ(*slot, static_cast<std::size_t>(found - ids.begin()));
  }
}

TEST(TactorProtocol, NamesEachTactorsAndGroupsIdsAsSection42Does) {
  for (std::size_t tactor = 0; tactor < kTactorCount; ++tactor) {
    const std::size_t base = tactor < 8 ? tactor : 30 + tactor - 8;
    EXPECT_EQ(id_of_slot(continuous_slot(tactor)), base);
    EXPECT_EQ(id_of_slot(pulsed_slot(tactor)), base + 10);
    EXPECT_EQ(mode_of_slot(continuous_slot(tactor)), Mode::kContinuous);
    EXPECT_EQ(mode_of_slot(pulsed_slot(tactor)), Mode::kPulsed);
  }
  const int saltation[4][2] = {{20, 21}, {22, 23}, {50, 51}, {52, 53}};
  for (std::size_t group = 0; group < 4; ++group) {
    for (const bool reverse : {false, true}) {
      EXPECT_EQ(id_of_slot(saltation_slot(group, reverse)), saltation[group][reverse]);
      EXPECT_EQ(mode_of_slot(saltation_slot(group, reverse)), Mode::kSaltation);
    }
  }
}

TEST(IntensityTable, RunsFromTheFaintestToTheStrongest) {
  EXPECT_NEAR(drive_of(54).level, 0.30, 1e-12);
  EXPECT_NEAR(drive_of(54).pulse_rate_hz, 5.0, 1e-12);
  EXPECT_NEAR(drive_of(54).tap_interval, 0.120, 1e-12);
  EXPECT_DOUBLE_EQ(drive_of(255).level, 1.0);
  EXPECT_DOUBLE_EQ(drive_of(255).pulse_rate_hz, 15.0);  // 4.3: "up to 15 Hz"
  EXPECT_DOUBLE_EQ(drive_of(255).tap_interval, 0.040);
}

TEST(IntensityTable, IsMonotoneInAllThreeAndEqualStepsAreEqualRatios) {
  for (int i = 1; i < 256; ++i) {
    const Drive a = drive_of(static_cast<std::uint8_t>(i - 1));
    const Drive b = drive_of(static_cast<std::uint8_t>(i));
    if (i < kFaintestIntensity) {
      EXPECT_EQ(b.level, 0.0);
      EXPECT_EQ(b.pulse_rate_hz, 0.0);
    } else {
      EXPECT_GT(b.level, a.level);
      EXPECT_GT(b.pulse_rate_hz, a.pulse_rate_hz);
    }
    EXPECT_LE(b.tap_interval, a.tap_interval);
    if (i > kFaintestIntensity) {
      EXPECT_NEAR(b.level / a.level, std::pow(0.30, -1.0 / 201.0), 1e-12);
      EXPECT_NEAR(b.pulse_rate_hz * b.tap_interval, 0.6, 1e-12);
    }
  }
}

TEST(IntensityTable, GivesTheSmallestIntensityThatReachesALevel) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> levels(0.0, 1.0);
  for (int n = 0; n < 1000; ++n) {
    const double level = levels(random);
    const std::uint8_t i = intensity_for_level(level);
    EXPECT_GE(drive_of(i).level, level);
    EXPECT_TRUE(i == kFaintestIntensity || drive_of(i - 1).level < level);
  }
  for (int i = kFaintestIntensity; i < 256; ++i) {
    EXPECT_EQ(intensity_for_level(drive_of(static_cast<std::uint8_t>(i)).level), i);
  }
  EXPECT_EQ(intensity_for_level(0.0), 0);
  EXPECT_EQ(intensity_for_level(-1.0), 0);
  EXPECT_EQ(intensity_for_level(std::numeric_limits<double>::quiet_NaN()), 0);
  EXPECT_EQ(intensity_for_level(1e-9), kFaintestIntensity);
  EXPECT_EQ(intensity_for_level(std::numeric_limits<double>::infinity()), 255);
}

TEST(TactorProtocol, CarriesEverySlotAndIntensityThereAndBack) {
  for (std::size_t slot = 0; slot < kSlotCount; ++slot) {
    for (int intensity = 0; intensity < 256; ++intensity) {
      const auto pair = encode(slot, static_cast<std::uint8_t>(intensity));
      EXPECT_TRUE(pair[1] == 0 || pair[1] >= kFaintestIntensity);
      CommandParser parser;
      EXPECT_FALSE(parser.push(pair[0], 0.0));
      const auto command = parser.push(pair[1], kByteTime);
      ASSERT_TRUE(command);
      EXPECT_EQ(command->slot, slot);
      EXPECT_EQ(command->intensity, intensity < kFaintestIntensity ? 0 : intensity);
      EXPECT_EQ(parser.dropped_bytes(), 0U);
    }
  }
}

TEST(CommandParser, TakesAnIdInPlaceOfAnIntensityAsTheNextCommand) {
  CommandParser parser;
  EXPECT_FALSE(parser.push(5, 0.0));   // its intensity is lost
  EXPECT_FALSE(parser.push(12, 0.0));  // cannot be an intensity
  const auto command = parser.push(99, 0.0);
  ASSERT_TRUE(command);
  EXPECT_EQ(command->slot, *slot_of_id(12));
  EXPECT_EQ(command->intensity, 99);
  EXPECT_EQ(parser.dropped_bytes(), 1U);
}

TEST(CommandParser, DropsWhatIsNoIdAndForgetsTheOneThatWaits) {
  CommandParser parser;
  EXPECT_FALSE(parser.push(200, 0.0));  // no ID
  EXPECT_FALSE(parser.push(8, 0.0));    // 8, 9, 18, 19, 24-29 ... are none either
  EXPECT_FALSE(parser.push(5, 0.0));
  EXPECT_FALSE(parser.push(29, 0.0));  // neither an intensity nor an ID
  EXPECT_FALSE(parser.push(200, 0.0));
  EXPECT_EQ(parser.dropped_bytes(), 5U);
}

TEST(CommandParser, ForgetsAnIdAfterThePairTimeoutAndNotBefore) {
  CommandParser parser;
  EXPECT_FALSE(parser.push(5, 1.0));
  EXPECT_TRUE(parser.push(200, 1.0 + 0.019));
  EXPECT_FALSE(parser.push(5, 2.0));
  EXPECT_FALSE(parser.push(200, 2.0 + CommandParser::kPairTimeout + 1e-9));
  EXPECT_EQ(parser.dropped_bytes(), 2U);
}

TEST(CommandParser, SurvivesAMillionRandomBytes) {
  std::mt19937 random(2);
  std::uniform_int_distribution<int> byte(0, 255);
  std::uniform_real_distribution<double> gap(0.0, 0.022);
  CommandParser parser;
  std::uint64_t commands = 0;
  double time = 0.0;
  const int count = 1'000'000;
  for (int i = 0; i < count; ++i) {
    time += i % 7 == 0 ? gap(random) : kByteTime;
    if (const auto command = parser.push(static_cast<std::uint8_t>(byte(random)), time)) {
      ++commands;
      ASSERT_LT(command->slot, kSlotCount);
      ASSERT_TRUE(command->intensity == 0 || command->intensity >= kFaintestIntensity);
    }
  }
  // Every byte is half of a command or dropped, but perhaps one that still waits.
  const std::uint64_t accounted = 2 * commands + parser.dropped_bytes();
  EXPECT_GE(accounted + 1, static_cast<std::uint64_t>(count));
  EXPECT_LE(accounted, static_cast<std::uint64_t>(count));
  EXPECT_GT(commands, 10'000U);
}

TEST(AllOff, NamesEveryIdOnceWithIntensityZero) {
  const auto bytes = encode_all_off();
  ASSERT_EQ(bytes.size(), 80U);
  std::vector<int> ids;
  for (std::size_t i = 0; i < bytes.size(); i += 2) {
    ids.push_back(bytes[i]);
    EXPECT_EQ(bytes[i + 1], 0);
  }
  std::sort(ids.begin(), ids.end());
  EXPECT_EQ(ids, ids_of_section_4_2());
}

TEST(AllOff, TakesEffectWhateverOneOrTwoBytesCameBefore) {
  // Every state of the parser is reached by at most one byte; two bytes reach it in every way.
  const auto all_off = encode_all_off();
  const auto check = [&](std::initializer_list<std::uint8_t> before) {
    BoardPatterns board = everything_on();
    CommandParser parser;
    const auto push = [&](std::uint8_t byte) {
      if (const auto command = parser.push(byte, 0.0)) board.apply(*command, 0.0);
    };
    for (const std::uint8_t byte : before) push(byte);
    for (const std::uint8_t byte : all_off) push(byte);
    return board.state() == kAllOff;
  };
  EXPECT_TRUE(check({}));
  for (int a = 0; a < 256; ++a) {
    ASSERT_TRUE(check({static_cast<std::uint8_t>(a)})) << a;
    for (int b = 0; b < 256; ++b) {
      ASSERT_TRUE(check({static_cast<std::uint8_t>(a), static_cast<std::uint8_t>(b)}))
          << a << ' ' << b;
    }
  }
}

TEST(AllOff, WouldLoseSlotZeroIfItBeganWithIt) {
  // Why encode_all_off() runs downwards.
  BoardPatterns board = everything_on();
  CommandParser parser;
  EXPECT_FALSE(parser.push(7, 0.0));  // torn: its intensity never comes
  for (std::size_t slot = 0; slot < kSlotCount; ++slot) {
    for (const std::uint8_t byte : encode(slot, 0)) {
      if (const auto command = parser.push(byte, 0.0)) board.apply(*command, 0.0);
    }
  }
  EXPECT_NE(board.state()[0], 0);
}

TEST(AllOff, SentTwiceSurvivesAnyLostByteFromAnyState) {
  const auto once = encode_all_off();
  std::vector<std::uint8_t> twice(once.begin(), once.end());
  twice.insert(twice.end(), once.begin(), once.end());
  for (int before = -1; before < 256; ++before) {
    for (std::size_t lost = 0; lost < twice.size(); ++lost) {
      BoardPatterns board = everything_on();
      CommandParser parser;
      const auto push = [&](std::uint8_t byte) {
        if (const auto command = parser.push(byte, 0.0)) board.apply(*command, 0.0);
      };
      if (before >= 0) push(static_cast<std::uint8_t>(before));
      for (std::size_t i = 0; i < twice.size(); ++i) {
        if (i != lost) push(twice[i]);
      }
      ASSERT_EQ(board.state(), kAllOff) << "after byte " << before << ", without byte " << lost;
    }
  }
}

TEST(DamagedStream, NeverDrivesWhatWasNotCommandedAfterALostByte) {
  std::mt19937 random(3);
  for (int n = 0; n < 40; ++n) {
    const std::vector<std::uint8_t> bytes = random_stream(random, 60);
    const auto clean = parse(bytes);
    for (std::size_t lost = 0; lost < bytes.size(); ++lost) {
      std::vector<std::uint8_t> damaged = bytes;
      damaged.erase(damaged.begin() + static_cast<long>(lost));
      ASSERT_EQ(uncommanded(clean, parse(damaged), lost, -1), 0U) << "byte " << lost;
    }
  }
}

TEST(DamagedStream, SetsAtMostOneSlotWrongAfterAGarbledOrGainedByte) {
  std::mt19937 random(4);
  std::uniform_int_distribution<int> any(0, 255);
  std::size_t worst = 0;
  for (int n = 0; n < 40; ++n) {
    const std::vector<std::uint8_t> bytes = random_stream(random, 60);
    const auto clean = parse(bytes);
    for (std::size_t at = 0; at < bytes.size(); ++at) {
      const auto value = static_cast<std::uint8_t>(any(random));
      std::vector<std::uint8_t> garbled = bytes;
      garbled[at] = value;
      std::vector<std::uint8_t> gained = bytes;
      gained.insert(gained.begin() + static_cast<long>(at), value);
      const std::size_t by_garbling = uncommanded(clean, parse(garbled), at, 0);
      const std::size_t by_gaining = uncommanded(clean, parse(gained), at, 1);
      ASSERT_LE(by_garbling, 1U) << "byte " << at << " as " << int{value};
      ASSERT_LE(by_gaining, 1U) << "byte " << at << " as " << int{value};
      worst = std::max({worst, by_garbling, by_gaining});
    }
  }
  EXPECT_EQ(worst, 1U);  // the bound is reached: a pair carries no check
}

}  // namespace
}  // namespace secondskin::wire
