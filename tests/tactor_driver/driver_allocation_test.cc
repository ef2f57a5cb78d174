#include <gtest/gtest.h>

#include <cstdlib>

#include "clients/tactor_driver/driver_core.h"
#include "sim/board/virtual_board.h"
#include "tests/count_malloc.h"

#ifdef COUNTS_MALLOC
#define SECONDSKIN_SANITIZED 0
#else
#define SECONDSKIN_SANITIZED 1
namespace {
long allocations = 0;
}
#endif

namespace secondskin::tactor_driver {
namespace {

TEST(Allocation, IsCounted) {
  if (SECONDSKIN_SANITIZED) GTEST_SKIP() << "the sanitizer replaces malloc";
  const long before = allocations;
  std::free(std::malloc(8));
  delete new int(3);
  EXPECT_GE(allocations - before, 1);
}

TEST(DriverCore, AllocatesNothingFromCommandToByte) {
  if (SECONDSKIN_SANITIZED) GTEST_SKIP() << "the sanitizer replaces malloc";
  DriverCore core;
  core.link_up(0.0);
  DriverCommand command;
  command.valid_for = 0.05;
  std::array<std::uint8_t, 80> out;
  std::size_t bytes = 0;
  const long before = allocations;
  for (int n = 0; n < 5000; ++n) {
    const double now = n * 0.004;
    command.number = static_cast<std::uint64_t>(n) + 1;
    command.intensities[static_cast<std::size_t>(n) % wire::kSlotCount] =
        static_cast<std::uint8_t>(n);
    if (n % 7 == 0) command.valid_for = -1.0;
    core.push(command, now);
    command.valid_for = 0.05;
    if (n % 1000 == 0) core.stop(true, now);
    if (n % 1000 == 100) core.stop(false, now);
    if (n % 1500 == 0) core.coach_lost(now);
    if (n % 1700 == 0) core.link_up(now);
    const std::size_t count = core.next_bytes(now, out);
    core.not_taken(count / 3, now);
    core.observe_backlog(0, now);
    bytes += count + (core.next_due(now) < 0.0 ? 1U : 0U);
  }
  EXPECT_EQ(allocations - before, 0U);
  EXPECT_GT(bytes, 1000U);
}

TEST(VirtualBoard, AllocatesNothingFromByteToDrive) {
  if (SECONDSKIN_SANITIZED) GTEST_SKIP() << "the sanitizer replaces malloc";
  sim::VirtualBoard board;
  wire::drive_of(0);
  const long before = allocations;
  for (int n = 0; n < 5000; ++n) {
    const double now = n * 0.004;
    board.receive(
        wire::encode(static_cast<std::size_t>(n) % wire::kSlotCount, static_cast<std::uint8_t>(n)),
        now);
    board.step(now + 0.002);
  }
  EXPECT_EQ(allocations - before, 0U);
}

}  // namespace
}  // namespace secondskin::tactor_driver
