#include "server/wearable/signal/inertial_decoder.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>
#include <random>
#include <vector>

#include "sim/wearable/inertial_encoder.h"

namespace secondskin::server {
namespace {

constexpr std::size_t kSlot = 1120;
constexpr double kLevel = 300.0;  // [A/D counts]

struct Line {
  double period = 1000.0, start = 0.0, noise = 0.0, offset = 0.0;
  unsigned seed = 1;
  /// Changes A/D sample n.
  std::function<double(std::int64_t n, double x)> disturb;
};

struct Sent {
  double start;
  wire::InertialCode code;
};

/// Sends random values for so many slots. @param received called with what comes of each slot
std::vector<Sent> send(const Line& line, InertialDecoder& decoder, int slots,
                       const std::function<void(std::span<const InertialSample>)>& received) {
  sim::InertialEncoder encoder(line.period, line.start, line.seed);
  std::mt19937 random(line.seed);
  std::normal_distribution<double> gauss;
  std::uniform_real_distribution<double> value(-1.0, 1.0);
  std::vector<Sent> sent;
  std::vector<std::int16_t> signal(kSlot);
  double next_start = line.start;
  std::int64_t n = 0;
  for (int slot = 0; slot < slots; ++slot) {
    for (auto& out : signal) {
      if (encoder.due()) {
        encoder.take({value(random), value(random), value(random), value(random), value(random),
                      value(random)});
        sent.push_back({next_start, encoder.sent()});
        next_start += line.period;
      }
      double x = line.offset + kLevel * encoder.next();
      if (line.noise > 0.0) x += line.noise * gauss(random);
      if (line.disturb) x = line.disturb(n, x);
      out = static_cast<std::int16_t>(std::lround(std::clamp(x, -32768.0, 32767.0)));
      ++n;
    }
    received(decoder.feed(signal));
  }
  return sent;
}

struct Score {
  std::size_t right = 0, wrong = 0;
  double first = -1.0, worst_timing = 0.0;
};

Score run(const Line& line, InertialDecoder& decoder, int slots) {
  std::vector<InertialSample> got;
  const auto sent = send(line, decoder, slots, [&](std::span<const InertialSample> samples) {
    got.insert(got.end(), samples.begin(), samples.end());
  });
  Score score;
  std::size_t i = 0;
  for (const auto& sample : got) {
    if (score.first < 0.0) score.first = sample.start;
    while (i < sent.size() && sent[i].start < sample.start - 0.5 * line.period) ++i;
    const bool right = i < sent.size() && sent[i].code == sample.code;
    ++(right ? score.right : score.wrong);
    if (right && sample.start - score.first > 20.0 * line.period) {
      score.worst_timing = std::max(score.worst_timing, std::abs(sample.start - sent[i].start));
    }
  }
  return score;
}

TEST(DecodeChips, CorrectsThreeWrongChipsInEveryWordAndNoticesFour) {
  std::mt19937 random(1);
  std::size_t refused = 0, wrong = 0;
  for (int trial = 0; trial < 20'000; ++trial) {
    wire::InertialCode code;
    for (auto& value : code.values) value = static_cast<std::uint8_t>(random() % 64);
    code.counter = static_cast<std::uint8_t>(random() % 16);
    const auto sent = wire::encode_chips(code);
    auto chips = sent;
    const auto break_bits = [&](std::size_t word, int bits) {
      while (bits > 0) {
        const std::size_t k = 3 * (random() % wire::kWordBits) + word;
        if (chips[k] != sent[k]) continue;
        chips[k] ^= 1;
        --bits;
      }
    };
    int broken = 0;
    for (std::size_t w = 0; w < 3; ++w) {
      const int bits = static_cast<int>(random() % 4);
      break_bits(w, bits);
      broken += bits;
    }
    int corrected = 0;
    const auto got = decode_chips(chips, corrected);
    ASSERT_TRUE(got);
    EXPECT_EQ(*got, code);
    EXPECT_EQ(corrected, broken);

    chips = sent;
    break_bits(random() % 3, 4);
    const auto fourth = decode_chips(chips, corrected);
    refused += fourth ? 0 : 1;
    wrong += fourth && !(*fourth == code) ? 1 : 0;
  }
  // Of words with four wrong bits most are outside every sphere, and the CRC finds the others but
  // one in 256.
  EXPECT_GT(refused, 19'900U);
  EXPECT_LT(wrong, 40U);
}

TEST(InertialDecoder, LocksAtAnyStart) {
  std::mt19937 random(2);
  for (int trial = 0; trial < 150; ++trial) {
    Line line;
    line.start = static_cast<double>(random() % 10'000) / 10.0;
    line.offset = static_cast<double>(random() % 4000) - 2000.0;
    line.noise = 0.2 * kLevel;
    line.seed = static_cast<unsigned>(trial);
    InertialDecoder decoder(1000.0, kSlot);
    const Score score = run(line, decoder, 40);
    ASSERT_TRUE(decoder.locked()) << line.start;
    EXPECT_EQ(score.wrong, 0U);
    EXPECT_GE(score.right, 42U) << line.start;
    EXPECT_LT(score.first, 4100.0);
    EXPECT_LT(score.worst_timing, 0.5);
    EXPECT_EQ(decoder.counts().locks, 1U);
    EXPECT_NEAR(decoder.level(), 0.8 * kLevel, 0.12 * kLevel);
  }
}

TEST(InertialDecoder, FollowsABoardWhoseClockIsOff) {
  for (const double ppm : {-400.0, -100.0, 100.0, 400.0}) {
    Line line;
    line.period = 1000.0 * (1.0 + 1e-6 * ppm);
    line.start = 333.3;
    line.noise = 0.5 * kLevel;
    InertialDecoder decoder(1000.0, kSlot);
    const Score score = run(line, decoder, 1000);
    EXPECT_EQ(score.wrong, 0U);
    EXPECT_GE(score.right, 1112U) << ppm;
    EXPECT_LT(score.worst_timing, 1.0) << ppm;
  }
}

TEST(InertialDecoder, ReadsThroughBurstsOfFortyKilohertzFiftyTimesAsStrong) {
  Line line;
  line.noise = 0.2 * kLevel;
  line.disturb = [](std::int64_t n, double x) {
    const std::int64_t at = n % 1120 - 100;
    return at < 0 || at >= 60
               ? x
               : x + 50.0 * kLevel * std::sin(std::numbers::pi * static_cast<double>(at) / 60.0) *
                         std::sin(2.0 * std::numbers::pi * 40.0 / 140.0 * static_cast<double>(n));
  };
  InertialDecoder decoder(1000.0, kSlot);
  const Score score = run(line, decoder, 500);
  EXPECT_EQ(score.wrong, 0U);
  EXPECT_GE(score.right, 553U);
}

TEST(InertialDecoder, LosesLockInSilenceAndFindsItAgainAtAnotherPhase) {
  InertialDecoder decoder(1000.0, kSlot);
  Line line;
  line.noise = 0.1 * kLevel;
  EXPECT_EQ(run(line, decoder, 100).wrong, 0U);
  ASSERT_TRUE(decoder.locked());
  const auto before = decoder.counts();
  // The board is silent for a second: noise alone.
  Line silent = line;
  std::mt19937 random(9);
  std::normal_distribution<double> gauss(0.0, 30.0);
  silent.disturb = [&](std::int64_t, double) { return gauss(random); };
  std::size_t given = 0;
  (void)send(silent, decoder, 125,
             [&](std::span<const InertialSample> samples) { given += samples.size(); });
  EXPECT_LE(given, 1U);  // the one whose last chips were in the low-pass
  EXPECT_FALSE(decoder.locked());
  EXPECT_NEAR(static_cast<double>(decoder.counts().lost - before.lost), 140.0, 4.0);
  // It comes back, having been restarted.
  line.start = 512.7;
  line.seed = 5;
  std::vector<InertialSample> got;
  const auto sent = send(line, decoder, 100, [&](std::span<const InertialSample> samples) {
    got.insert(got.end(), samples.begin(), samples.end());
  });
  ASSERT_TRUE(decoder.locked());
  EXPECT_EQ(decoder.counts().locks, 2U);
  ASSERT_GE(got.size(), 106U);
  EXPECT_EQ(got.back().code, sent[sent.size() - 2].code);
}

TEST(InertialDecoder, SaysWhatIsLostInNoiseAndHardlyEverGivesAWrongValue) {
  // A chip is wrong once in ten or so: most samples are lost, and said to be.
  Line line;
  line.noise = 2.2 * kLevel;
  InertialDecoder decoder(1000.0, kSlot);
  const Score score = run(line, decoder, 4000);
  const auto total = static_cast<double>(decoder.counts().lost + decoder.counts().samples);
  EXPECT_NEAR(total, 4480.0, 15.0);
  EXPECT_GT(score.right, 500U);
  EXPECT_GT(decoder.counts().lost, 500U);
  EXPECT_LE(score.wrong, 2U);
}

TEST(InertialDecoder, GivesOutTheSameHoweverTheSignalIsCut) {
  Line line;
  line.noise = 0.3 * kLevel;
  line.start = 77.0;
  std::vector<std::int16_t> signal;
  sim::InertialEncoder encoder(line.period, line.start, 3);
  std::mt19937 random(3);
  std::normal_distribution<double> gauss(0.0, 100.0);
  for (int n = 0; n < 60'000; ++n) {
    if (encoder.due()) encoder.take({0.1, -0.2, 0.3, 0.0, 0.0, 0.33});
    signal.push_back(
        static_cast<std::int16_t>(std::lround(kLevel * encoder.next() + gauss(random))));
  }
  const auto decode = [&](std::size_t most) {
    InertialDecoder decoder(1000.0, 4000);
    std::vector<double> starts;
    for (std::size_t at = 0; at < signal.size();) {
      const std::size_t n = std::min(most == 0 ? 1 + random() % 4000 : most, signal.size() - at);
      for (const auto& sample : decoder.feed(std::span(signal).subspan(at, n))) {
        starts.push_back(sample.start);
      }
      at += n;
    }
    return starts;
  };
  const auto whole = decode(4000);
  EXPECT_GE(whole.size(), 56U);
  EXPECT_EQ(decode(1), whole);
  EXPECT_EQ(decode(0), whole);
}

}  // namespace
}  // namespace secondskin::server
