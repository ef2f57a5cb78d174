#include "clients/dashboard/outbox.h"

#include <gtest/gtest.h>

namespace secondskin::dashboard {
namespace {

Frame frame(std::uint8_t mark, std::optional<std::uint32_t> stream, std::size_t size = 1) {
  return {.body = std::make_shared<const std::vector<std::uint8_t>>(size, mark),
          .head = {},
          .text = false,
          .stream = stream};
}

std::vector<int> marks(Outbox& box) {
  std::vector<int> out;
  while (auto next = box.pop()) out.push_back(next->body->front());
  return out;
}

TEST(Outbox, KeepsOnlyTheNewestOfAStream) {
  Outbox box(100);
  for (std::uint8_t i = 0; i < 50; ++i) EXPECT_TRUE(box.push(frame(i, 1)));
  EXPECT_TRUE(box.push(frame(77, 2)));
  EXPECT_EQ(marks(box), (std::vector<int>{49, 77}));
  EXPECT_EQ(box.skipped(), 49u);
}

TEST(Outbox, KeepsTheRestWholeInOrderAndFirst) {
  Outbox box(100);
  EXPECT_TRUE(box.push(frame(9, 1)));
  for (std::uint8_t i = 0; i < 5; ++i) EXPECT_TRUE(box.push(frame(i, {})));
  EXPECT_EQ(marks(box), (std::vector<int>{0, 1, 2, 3, 4, 9}));
}

TEST(Outbox, IsFullByBytesOfWhatMayNotBeSkipped) {
  Outbox box(100);
  EXPECT_TRUE(box.push(frame(1, {}, 60)));
  EXPECT_FALSE(box.push(frame(2, {}, 60)));
  EXPECT_TRUE(box.push(frame(3, 1, 1000)));  // one of a stream is never too much
  EXPECT_EQ(marks(box), (std::vector<int>{1, 3}));
  EXPECT_TRUE(box.push(frame(4, {}, 100)));  // what was taken makes room
}

TEST(Outbox, ForgetsAStream) {
  Outbox box(100);
  EXPECT_TRUE(box.push(frame(1, 1)));
  EXPECT_TRUE(box.push(frame(2, 2)));
  box.forget(1);
  EXPECT_EQ(marks(box), (std::vector<int>{2}));
}

}  // namespace
}  // namespace secondskin::dashboard
