#include "server/optical/track/value_filter.h"

#include <gtest/gtest.h>

#include <stdexcept>

namespace secondskin::server {
namespace {

// One detector, one projector.
std::vector<int> filtered(const std::vector<int>& values, const ValueFilterOptions& options = {}) {
  ValueFilter filter(1, 1, options);
  std::vector<int> out;
  for (const int value : values) {
    const std::uint8_t in = static_cast<std::uint8_t>(value);
    std::uint8_t result = 99;
    filter.update({&in, 1}, {&result, 1});
    out.push_back(result);
  }
  return out;
}

TEST(ValueFilter, HasThePapersConstants) {  // 2.2.4
  const ValueFilterOptions options;
  EXPECT_EQ(options.history, 15U);
  EXPECT_EQ(options.jump, 6);
  EXPECT_EQ(options.jumps, 3);
}

TEST(ValueFilter, GivesSmoothValuesOneCycleLater) {
  EXPECT_EQ(filtered({100, 103, 106, 109, 108}), (std::vector<int>{0, 100, 103, 106, 108}));
  EXPECT_EQ(ValueFilter(1, 1).delay_frames(), 1U);
}

TEST(ValueFilter, PassesThreeJumpsAndNotFour) {
  const ValueFilterOptions plain{.median = 1};
  EXPECT_EQ(filtered({10, 17, 24, 31}, plain).back(), 31);
  EXPECT_EQ(filtered({10, 17, 24, 31, 38}, plain).back(), 0);
  EXPECT_EQ(filtered({10, 16, 22, 28, 34, 40}, plain).back(), 40);  // steps of 6 are no jumps
  // Fifteen values hold fourteen steps: the first jump is forgotten after fourteen more.
  std::vector<int> values{10, 17, 24, 31, 38};
  for (int i = 0; i < 10; ++i) values.push_back(38);
  EXPECT_EQ(filtered(values, plain).back(), 0);
  values.push_back(38);
  EXPECT_EQ(filtered(values, plain).back(), 38);
}

TEST(ValueFilter, TakesAStrayValueOutAndKeepsItInTheHistory) {
  const auto once = filtered({100, 100, 200, 100, 100});
  EXPECT_EQ(once, (std::vector<int>{0, 100, 100, 100, 100}));
  // Two stray values are four jumps, though the median has removed both.
  EXPECT_EQ(filtered({100, 100, 200, 100, 100, 200, 100, 100}).back(), 0);
}

TEST(ValueFilter, TakesAMissingValueForNoStepAndMakesNoneUp) {
  EXPECT_EQ(filtered({100, 0, 101, 0, 102, 0, 103, 0, 104, 104}),
            (std::vector<int>{0, 100, 0, 101, 0, 102, 0, 103, 0, 104}));
  // Moved by 40 behind something: one jump.
  EXPECT_EQ(filtered({100, 100, 0, 0, 0, 140, 140}).back(), 140);
}

TEST(ValueFilter, KeepsDetectorsAndProjectorsApart) {
  ValueFilter filter(2, 2);
  std::vector<std::uint8_t> out(4);
  for (int i = 0; i < 20; ++i) {
    const std::uint8_t wild = i % 2 == 0 ? 10 : 200;
    filter.update(std::vector<std::uint8_t>{50, wild, 60, 70}, out);
  }
  EXPECT_EQ(out, (std::vector<std::uint8_t>{50, 0, 60, 70}));
}

TEST(ValueFilter, RefusesOptionsOutOfRange) {
  EXPECT_THROW(ValueFilter(1, 1, {.history = 0}), std::invalid_argument);
  EXPECT_THROW(ValueFilter(1, 1, {.median = 2}), std::invalid_argument);
  EXPECT_THROW(ValueFilter(1, 1, {.history = 3, .median = 5}), std::invalid_argument);
  EXPECT_THROW(ValueFilter(1, 1, {.jump = -1}), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
