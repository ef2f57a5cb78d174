#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <random>
#include <thread>

#include "recording/mcap_reader.h"
#include "recording/mcap_writer.h"
#include "tests/recording/mcap_files.h"

namespace secondskin::recording {
namespace {

using testing::bytes;
using testing::TemporaryFolder;
using Clock = std::chrono::system_clock;

std::int64_t now_ns() { return std::chrono::nanoseconds(Clock::now().time_since_epoch()).count(); }

/// What the writing process says, in memory that outlives it.
struct Progress {
  std::atomic<std::uint32_t> written{0};  // messages whose write() has returned
  std::atomic<bool> failed{false};
  std::array<std::int64_t, 1'000'000> times{};  // of each message
};

[[noreturn]] void write_for_ever(const std::filesystem::path& file, Progress& progress,
                                 std::chrono::microseconds pause, std::size_t size) {
  try {
    McapWriter writer(file);
    const auto channel = writer.add_channel("a", "A", "omgidl", "struct A { long x; };");
    for (std::uint32_t i = 0; i < progress.times.size(); ++i) {
      const std::int64_t now = now_ns();
      progress.times[i] = now;
      writer.write(channel, i, now, now, bytes(i, size));
      progress.written = i + 1;
      if (pause.count() > 0) std::this_thread::sleep_for(pause);
    }
  } catch (...) {
    progress.failed = true;
  }
  ::_exit(1);
}

/// Kills a writer once it has written `least` messages and `life` has passed; the file must hold
/// every message but those of the last half second.
void kill_and_read(std::chrono::microseconds pause, std::size_t size, std::uint32_t least,
                   std::chrono::milliseconds life, std::uint32_t& left) {
  const TemporaryFolder folder;
  const auto file = folder / "killed.mcap";
  void* memory =
      ::mmap(nullptr, sizeof(Progress), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  ASSERT_NE(memory, MAP_FAILED);
  auto& progress = *new (memory) Progress;
  const pid_t writer = ::fork();
  ASSERT_GE(writer, 0);
  if (writer == 0) write_for_ever(file, progress, pause, size);
  const auto patience = Clock::now() + std::chrono::seconds(20);  // for a busy machine
  while (progress.written < least && Clock::now() < patience) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  std::this_thread::sleep_for(life);
  ::kill(writer, SIGKILL);
  int status = 0;
  ASSERT_EQ(::waitpid(writer, &status, 0), writer);
  EXPECT_FALSE(progress.failed);
  ASSERT_TRUE(WIFSIGNALED(status));

  McapReader reader(file);
  EXPECT_FALSE(reader.finished());
  std::uint32_t next = 0;
  reader.for_each([&](const McapMessage& message) {
    EXPECT_EQ(message.sequence, next);
    const auto expected = bytes(next, size);
    EXPECT_TRUE(
        std::equal(message.data.begin(), message.data.end(), expected.begin(), expected.end()));
    ++next;
    return true;
  });
  EXPECT_EQ(next, reader.messages());
  // One more than was confirmed may be stored: killed between storing and saying so.
  EXPECT_LE(next, progress.written + 1);
  if (next < progress.written) {
    EXPECT_LT(progress.times[progress.written - 1] - progress.times[next], 500'000'000);
  }
  ::munmap(memory, sizeof(Progress));
  left = next;
}

TEST(KilledWriter, LosesAtMostTheLastHalfSecond) {
  std::mt19937 random(1);
  for (int round = 0; round < 5; ++round) {
    std::uint32_t left = 0;
    const std::chrono::milliseconds life(700 + random() % 700);
    ASSERT_NO_FATAL_FAILURE(kill_and_read(std::chrono::milliseconds(2), 200, 1, life, left));
    EXPECT_GT(left, 20u);
  }
}

TEST(KilledWriter, LeavesAReadableFileThoughItWasStoringAtFullSpeed) {
  std::mt19937 random(2);
  for (int round = 0; round < 15; ++round) {
    std::uint32_t left = 0;
    const std::chrono::milliseconds life(150 + random() % 100);
    ASSERT_NO_FATAL_FAILURE(kill_and_read(std::chrono::microseconds(0), 5000, 300, life, left));
    EXPECT_GT(left, 100u);
  }
}

}  // namespace
}  // namespace secondskin::recording
