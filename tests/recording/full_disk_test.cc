#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mount.h>
#include <sys/resource.h>

#include <cerrno>
#include <cstring>
#include <random>
#include <system_error>

#include "recording/mcap_reader.h"
#include "recording/mcap_writer.h"
#include "tests/recording/mcap_files.h"

namespace secondskin::recording {
namespace {

using testing::bytes;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::kEpoch;
using testing::messages_of;
using testing::TemporaryFolder;

/// Lets no file of this process grow beyond a size, as `ulimit -f` does, until it goes out of
/// scope.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(std::uint64_t bytes) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    handler_ = ::signal(SIGXFSZ, SIG_IGN);  // so that write(2) says EFBIG
    const rlimit limit{bytes, before_.rlim_max};
    if (::setrlimit(RLIMIT_FSIZE, &limit) != 0) throw std::runtime_error("setrlimit");
  }
  ~FileSizeLimit() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    ::signal(SIGXFSZ, handler_);
  }

 private:
  rlimit before_{};
  sighandler_t handler_ = SIG_DFL;
};

std::vector<std::uint8_t> noise(std::uint32_t seed, std::size_t size) {
  std::mt19937 random(seed);
  std::vector<std::uint8_t> out(size);
  for (auto& byte : out) byte = static_cast<std::uint8_t>(random());
  return out;
}

/// Chunks of three messages each, until the file will take no more.
struct Outcome {
  std::error_code reason;
  std::string what;
  std::uint32_t stored = 0;  // messages whose chunk was stored without an error
  bool later_calls_throw = false;
};

Outcome write_until_full(const std::filesystem::path& file, std::uint32_t most) {
  Outcome outcome;
  McapWriter writer(file, {.chunk_bytes = 1 << 20, .chunk_seconds = 3600});
  const auto channel = writer.add_channel("a", "A", "omgidl", "struct A { long x; };");
  try {
    for (std::uint32_t i = 0; i < most; ++i) {
      writer.write(channel, i, kEpoch + i, kEpoch + i, noise(i, 300));
      if (i % 3 == 2) {
        writer.flush_if_due(kEpoch + 10'000'000'000'000);
        outcome.stored = i + 1;
      }
    }
    writer.close();
  } catch (const std::system_error& error) {
    outcome.reason = error.code();
    outcome.what = error.what();
    const auto throws = [](auto call) {
      try {
        call();
      } catch (const std::system_error&) {
        return true;
      }
      return false;
    };
    outcome.later_calls_throw = throws([&] { writer.write(channel, 0, kEpoch, kEpoch, {}); }) &&
                                throws([&] { writer.flush_if_due(kEpoch); }) &&
                                throws([&] { writer.write_metadata("m", {}); }) &&
                                throws([&] { writer.write_attachment("a", "b", 0, {}); }) &&
                                throws([&] { writer.add_channel("b", "", "", ""); }) &&
                                throws([&] { writer.close(); });
    EXPECT_EQ(writer.messages(), outcome.stored);
    EXPECT_EQ(writer.stored_bytes(), std::filesystem::file_size(file));
  }
  return outcome;
}

void expect_holds(const std::filesystem::path& file, std::uint32_t messages) {
  McapReader reader(file);
  EXPECT_THAT(reader.damage(), IsEmpty());
  const auto found = messages_of(reader);
  ASSERT_EQ(found.size(), messages);
  for (std::uint32_t i = 0; i < messages; ++i) {
    EXPECT_EQ(found[i].sequence, i);
    EXPECT_EQ(found[i].data, noise(i, 300));
  }
}

TEST(FullDisk, LeavesWholeChunksWhereverTheLimitFalls) {
  const TemporaryFolder folder;
  const auto whole = folder / "whole.mcap";
  write_until_full(whole, 15);
  const std::uint64_t size = std::filesystem::file_size(whole);
  int with_index = 0;
  int without_index = 0;
  for (std::uint64_t limit = 64; limit < size; limit += 31) {
    SCOPED_TRACE(limit);
    const auto file = folder / (std::to_string(limit) + ".mcap");
    Outcome outcome;
    {
      const FileSizeLimit full(limit);
      outcome = write_until_full(file, 15);
    }
    EXPECT_EQ(outcome.reason, std::errc::file_too_large);
    EXPECT_THAT(outcome.what, HasSubstr(file.string()));
    EXPECT_THAT(outcome.what, HasSubstr("File too large"));
    EXPECT_TRUE(outcome.later_calls_throw);
    EXPECT_LE(std::filesystem::file_size(file), limit);
    ASSERT_NO_FATAL_FAILURE(expect_holds(file, outcome.stored));
    ++(McapReader(file).finished() ? with_index : without_index);
  }
  EXPECT_GT(with_index, 10);
  EXPECT_GT(without_index, 3);
}

TEST(FullDisk, LeavesNoFileWhereNotEvenItsHeaderFits) {
  const TemporaryFolder folder;
  const FileSizeLimit full(10);
  EXPECT_THROW(McapWriter(folder / "session.mcap"), std::system_error);
  EXPECT_FALSE(std::filesystem::exists(folder / "session.mcap"));
}

TEST(FullDisk, KeepsTheMessagesBeforeAnAttachmentThatDoesNotFit) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  {
    const FileSizeLimit full(20'000);
    McapWriter writer(file);
    const auto channel = writer.add_channel("a", "A", "omgidl", "struct A { long x; };");
    for (std::uint32_t i = 0; i < 4; ++i)
      writer.write(channel, i, kEpoch + i, kEpoch, noise(i, 300));
    EXPECT_THROW(writer.write_attachment("large", "text/plain", kEpoch, noise(1, 30'000)),
                 std::system_error);
  }
  expect_holds(file, 4);
  EXPECT_TRUE(McapReader(file).finished());
  EXPECT_THAT(McapReader(file).attachments(), IsEmpty());
}

class SmallDisk : public ::testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::create_directory(disk_);
    if (::mount("tmpfs", disk_.c_str(), "tmpfs", 0, "size=256k") != 0) {
      GTEST_SKIP() << "mounting a small disk takes root: " << std::strerror(errno);
    }
    mounted_ = true;
  }
  void TearDown() override {
    if (mounted_) ::umount(disk_.c_str());
  }

  TemporaryFolder folder_;
  std::filesystem::path disk_ = folder_ / "disk";
  bool mounted_ = false;
};

TEST_F(SmallDisk, EndsTheRecordingWithItsIndexWhenFull) {
  const auto file = disk_ / "session.mcap";
  const Outcome outcome = write_until_full(file, 100'000);
  EXPECT_EQ(outcome.reason, std::errc::no_space_on_device);
  EXPECT_THAT(outcome.what, HasSubstr(file.string()));
  EXPECT_THAT(outcome.what, HasSubstr("No space left on device"));
  EXPECT_TRUE(outcome.later_calls_throw);
  EXPECT_GT(outcome.stored, 600u);
  expect_holds(file, outcome.stored);
  EXPECT_TRUE(McapReader(file).finished());  // the index had its place reserved
}

TEST_F(SmallDisk, EndsTheRecordingWithItsIndexWhenAnotherProgramFillsTheDisk) {
  const auto file = disk_ / "session.mcap";
  McapWriter writer(file, {.chunk_bytes = 1000, .chunk_seconds = 3600});
  const auto channel = writer.add_channel("a", "A", "omgidl", "struct A { long x; };");
  for (std::uint32_t i = 0; i < 40; ++i)
    writer.write(channel, i, kEpoch + i, kEpoch + i, noise(i, 300));
  testing::write_contents(disk_ / "other", std::vector<std::uint8_t>(1 << 20, 1));
  std::uint32_t next = 40;
  EXPECT_THROW(
      {
        for (; next < 100'000; ++next) {
          writer.write(channel, next, kEpoch + next, kEpoch + next, noise(next, 300));
        }
      },
      std::system_error);
  EXPECT_GE(writer.messages(), 36u);
  expect_holds(file, static_cast<std::uint32_t>(writer.messages()));
  EXPECT_TRUE(McapReader(file).finished());
}

TEST_F(SmallDisk, BeginsNoRecordingOnAFullOne) {
  testing::write_contents(disk_ / "other", std::vector<std::uint8_t>(1 << 20, 1));
  EXPECT_THROW(McapWriter(disk_ / "session.mcap"), std::system_error);
  EXPECT_FALSE(std::filesystem::exists(disk_ / "session.mcap"));
}

}  // namespace
}  // namespace secondskin::recording
