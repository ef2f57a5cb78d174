#include "wire/inertial_code.h"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <numbers>
#include <random>
#include <set>
#include <vector>

#include "sim/wearable/inertial_encoder.h"

namespace secondskin {
namespace {

using namespace secondskin::wire;

InertialCode random_code(std::mt19937& random) {
  InertialCode code;
  for (auto& value : code.values) value = static_cast<std::uint8_t>(random() % kValueCodes);
  code.counter = static_cast<std::uint8_t>(random() % kCounterCodes);
  return code;
}

TEST(BchCode, IsTheCyclicCodeWithThatGenerator) {
  // g(x) divides x^31 + 1, so every rotation of a code word is a code word; and it is made of the
  // minimal polynomials of a, a^3, a^5 in GF(32): (x^5+x^2+1)(x^5+x^4+x^3+x^2+1)(x^5+x^4+x^2+x+1).
  const auto times = [](std::uint32_t a, std::uint32_t b) {
    std::uint32_t product = 0;
    for (int i = 0; i < 16; ++i) product ^= (b >> i & 1U) != 0 ? a << i : 0U;
    return product;
  };
  EXPECT_EQ(times(times(045, 075), 067), 0107657U);
  for (std::uint32_t message = 1; message < 65536; message += 97) {
    const std::uint32_t word = bch_encode(static_cast<std::uint16_t>(message));
    EXPECT_EQ(bch_syndrome(word), 0);
    const std::uint32_t rotated = (word << 1 | word >> 30) & 0x7FFFFFFFU;
    EXPECT_EQ(bch_syndrome(rotated), 0);
  }
}

TEST(BchCode, WordsDifferInSevenBitsAtLeast) {
  int least = 31;
  for (std::uint32_t message = 1; message < 65536; ++message) {
    least = std::min(least, std::popcount(bch_encode(static_cast<std::uint16_t>(message))));
  }
  EXPECT_EQ(least, 7);
}

TEST(BchCode, EveryPatternOfUpToThreeErrorsHasASyndromeOfItsOwn) {
  std::set<std::uint16_t> seen{0};
  std::size_t patterns = 1;
  for (std::uint32_t a = 0; a < 31; ++a) {
    for (std::uint32_t b = a; b < 31; ++b) {
      for (std::uint32_t c = b; c < 31; ++c) {
        if (a != b && b == c) continue;  // as a, a, b
        const std::uint32_t pattern = 1U << a | 1U << b | 1U << c;
        seen.insert(bch_syndrome(pattern));
        ++patterns;
      }
    }
  }
  EXPECT_EQ(patterns, 1U + 31U + 465U + 4495U);
  EXPECT_EQ(seen.size(), patterns);
}

TEST(InertialCode, PacksAndUnpacks) {
  std::mt19937 random(1);
  for (int i = 0; i < 1000; ++i) {
    const InertialCode code = random_code(random);
    InertialCode back;
    ASSERT_TRUE(unpack(pack(code), back));
    EXPECT_EQ(back, code);
  }
}

TEST(InertialCode, CrcFindsEveryChangeOfUpToThreeBits) {
  std::mt19937 random(2);
  const auto words = pack(random_code(random));
  const auto refused = [&](std::uint64_t change) {
    auto changed = words;
    for (std::size_t w = 0; w < kWords; ++w) {
      changed[w] = static_cast<std::uint16_t>(changed[w] ^ (change >> (16 * w)));
    }
    InertialCode code;
    return !unpack(changed, code);
  };
  for (int a = 0; a < 48; ++a) {
    for (int b = a; b < 48; ++b) {
      for (int c = b; c < 48; ++c) {
        if (a != b && b == c) continue;
        EXPECT_TRUE(refused(std::uint64_t{1} << a | std::uint64_t{1} << b | std::uint64_t{1} << c));
      }
    }
  }
}

TEST(InertialCode, BurstOfNineChipsCostsNoWordMoreThanThreeBits) {
  std::mt19937 random(3);
  const Chips sent = encode_chips(random_code(random));
  for (std::size_t first = 0; first + 9 <= kChips; ++first) {
    std::array<int, kWords> wrong{};
    for (std::size_t k = first; k < first + 9; ++k) ++wrong[k % kWords];
    for (const int n : wrong) EXPECT_LE(n, kCorrectable);
  }
  EXPECT_EQ(sent.size(), 93U);  // 13 kbit/s at 140 Hz
}

TEST(InertialCode, ScramblingIsBalancedAndLooksLikeNoShiftOfItself) {
  const Chips& chips = scrambling();
  int ones = 0;
  for (const auto chip : chips) ones += chip;
  EXPECT_NEAR(ones, 46.5, 2.5);
  for (std::size_t shift = 1; shift < kChips; ++shift) {
    int agree = 0;
    for (std::size_t k = 0; k < kChips; ++k) agree += chips[k] == chips[(k + shift) % kChips];
    EXPECT_LT(agree, 66) << shift;  // 46.5 is chance
  }
}

TEST(DeltaModulator, SumOfCodesFollowsSumOfValuesToHalfAStep) {
  std::mt19937 random(4);
  DeltaModulator modulate;
  long values = 0, codes = 0;
  for (int k = 0; k < 10'000; ++k) {
    const int value = 100 + static_cast<int>(random() % 3800);
    values += value;
    codes += 64 * modulate(value);
    ASSERT_LE(std::abs(values - codes), 32);
  }
}

TEST(DeltaModulator, DoesNotWindUpBeyondTheRange) {
  DeltaModulator modulate;
  for (int k = 0; k < 1000; ++k) EXPECT_EQ(modulate(4095), 63);
  // What was cut off is forgotten: within two values it is at rest again.
  (void)modulate(2048);
  int sum = 0;
  for (int k = 0; k < 100; ++k) sum += modulate(2048);
  EXPECT_NEAR(sum, 3200, 1);
  for (int k = 0; k < 1000; ++k) EXPECT_LE(modulate(0), 1);
}

TEST(InertialCodeNoise, IsWhatTheCodeAdds) {
  // 500 degrees/s: the paper's gyroscopes.
  const double range = 500.0 * std::numbers::pi / 180.0;
  const auto theory = inertial_code_noise(range);
  EXPECT_NEAR(theory.step, 0.2727, 1e-4);
  EXPECT_NEAR(theory.sample, 0.1113, 1e-4);
  EXPECT_NEAR(theory.white(70.0), theory.sample, 1e-9);

  // A rate that wanders over many steps, through converter, accumulation and code.
  sim::InertialEncoder encoder(1000.0, 0.0, 5);
  std::mt19937 random(5);
  std::normal_distribution<double> push(0.0, 0.3);
  double x = 0.0, sum = 0.0, worst_sum = 0.0, square = 0.0;
  const int n = 20'000;
  std::vector<double> error;
  for (int k = 0; k < n; ++k) {
    x = 0.98 * x + push(random);
    encoder.take({x / range, 0, 0, 0, 0, 0});
    encoder.skip(1000);
    const double got = (encoder.sent().values[0] - 32) * theory.step;
    error.push_back(got - x);
    square += error.back() * error.back();
    sum += error.back() * theory.period;
    worst_sum = std::max(worst_sum, std::abs(sum));
  }
  EXPECT_NEAR(std::sqrt(square / n), theory.sample, 0.03 * theory.sample);
  // Low frequencies are as clean as the converter: means of 70 samples (a window of half a second).
  double low = 0.0;
  for (int k = 0; k + 70 <= n; k += 70) {
    double mean = 0.0;
    for (int j = 0; j < 70; ++j) mean += error[static_cast<std::size_t>(k + j)] / 70.0;
    low += mean * mean;
  }
  const double of_mean = std::sqrt(low / (n / 70));
  EXPECT_LT(of_mean, 0.2 * theory.sample / std::sqrt(70.0));  // white noise would be 1 of this
  EXPECT_LT(worst_sum, 0.02);                                 // [rad], after 143 s
}

}  // namespace
}  // namespace secondskin
