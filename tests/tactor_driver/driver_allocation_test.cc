#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>

#include "clients/tactor_driver/driver_core.h"
#include "sim/board/virtual_board.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SECONDSKIN_SANITIZED 1
#else
#define SECONDSKIN_SANITIZED 0
#endif

namespace {
std::atomic<std::size_t> allocations{0};
}

#if !SECONDSKIN_SANITIZED  // they replace malloc themselves
// Counted at malloc: not everything goes through operator new.
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* memory, std::size_t size);
void* malloc(std::size_t size) {
  ++allocations;
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  ++allocations;
  return __libc_calloc(count, size);
}
void* realloc(void* memory, std::size_t size) {
  ++allocations;
  return __libc_realloc(memory, size);
}
}
#endif

namespace secondskin::tactor_driver {
namespace {

TEST(Allocation, IsCounted) {
  if (SECONDSKIN_SANITIZED) GTEST_SKIP() << "the sanitizer replaces malloc";
  const std::size_t before = allocations;
  std::free(std::malloc(8));
  delete new int(3);
  EXPECT_GE(allocations - before, 1U);
}

TEST(DriverCore, AllocatesNothingFromCommandToByte) {
  if (SECONDSKIN_SANITIZED) GTEST_SKIP() << "the sanitizer replaces malloc";
  DriverCore core;
  core.link_up(0.0);
  DriverCommand command;
  command.valid_for = 0.05;
  std::array<std::uint8_t, 80> out;
  std::size_t bytes = 0;
  const std::size_t before = allocations;
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
  const std::size_t before = allocations;
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
