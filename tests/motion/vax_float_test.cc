#include "motion/vax_float.h"

#include <gtest/gtest.h>

#include <bit>
#include <random>

namespace secondskin {
namespace {

// The VAX number by its definition, in double precision: (−1)^s · 0.1f · 2^(e − 128).
double by_definition(std::uint32_t vax) {
  const double fraction = 0.5 + (vax & 0x7FFFFFU) / 16777216.0;
  const double magnitude = std::ldexp(fraction, static_cast<int>(vax >> 23 & 0xFFU) - 128);
  return vax >> 31 != 0 ? -magnitude : magnitude;
}

// VAX Architecture Reference Manual: 1.0 is 0x4080 in the first word; so 0.5, -1, 10, 1/3.
TEST(VaxFloat, ReadsNumbersThatAreKnown) {
  EXPECT_EQ(float_from_vax(0x40800000U), 1.0F);
  EXPECT_EQ(float_from_vax(0x40000000U), 0.5F);
  EXPECT_EQ(float_from_vax(0xC0800000U), -1.0F);
  EXPECT_EQ(float_from_vax(0x42200000U), 10.0F);
  EXPECT_EQ(float_from_vax(0x3FAAAAABU), 1.0F / 3.0F);
  EXPECT_EQ(float_from_vax(0x00000000U), 0.0F);
  EXPECT_EQ(float_from_vax(0x00001234U), 0.0F) << "zero whatever its fraction";
  EXPECT_TRUE(std::isnan(float_from_vax(kVaxReserved)));
}

TEST(VaxFloat, IsItsDefinitionOverTheWholeRange) {
  std::mt19937 generator(31);
  for (std::uint32_t exponent = 1; exponent < 256; ++exponent) {
    for (int draw = 0; draw < 200; ++draw) {
      std::uint32_t fraction = generator() & 0x7FFFFFU;
      if (draw < 2) fraction = draw == 0 ? 0U : 0x7FFFFFU;
      const std::uint32_t vax = (generator() & 1U) << 31 | exponent << 23 | fraction;
      const float value = float_from_vax(vax);
      ASSERT_EQ(value, static_cast<float>(by_definition(vax))) << std::hex << vax;
      // The two lowest exponents lie where a float loses bits.
      if (exponent > 2) {
        ASSERT_EQ(vax_from_float(value), vax) << std::hex << vax;
      }
    }
  }
}

TEST(VaxFloat, HoldsEveryFloatInItsRangeExactly) {
  std::mt19937 generator(32);
  for (int draw = 0; draw < 200000; ++draw) {
    const float value = std::bit_cast<float>(static_cast<std::uint32_t>(generator()));
    const auto vax = vax_from_float(value);
    if (std::isnan(value)) {
      ASSERT_EQ(vax, kVaxReserved);
    } else if (std::abs(value) >= 0x1p127F) {
      ASSERT_EQ(vax, std::nullopt) << value;
    } else if (std::abs(value) < 0x1p-128F) {
      ASSERT_EQ(vax, 0U) << value;
    } else {
      ASSERT_TRUE(vax);
      ASSERT_EQ(float_from_vax(*vax), value);
      ASSERT_EQ(by_definition(*vax), static_cast<double>(value));
    }
  }
}

TEST(VaxFloat, HasLimits) {
  EXPECT_EQ(vax_from_float(-0.0F), 0U) << "a VAX has one zero";
  EXPECT_EQ(vax_from_float(std::numeric_limits<float>::infinity()), std::nullopt);
  EXPECT_EQ(vax_from_float(0x1p127F), std::nullopt);
  EXPECT_EQ(vax_from_float(std::nextafter(0x1p127F, 0.0F)), 0x7FFFFFFFU);
  EXPECT_EQ(vax_from_float(0x1p-128F), 0x00800000U);
  EXPECT_EQ(vax_from_float(std::nextafter(0x1p-128F, 0.0F)), 0U);
}

}  // namespace
}  // namespace secondskin
