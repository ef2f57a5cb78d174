#include "recording/mcap_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <fstream>
#include <sstream>
#include <system_error>
#include <thread>

#include "recording/mcap_format.h"
#include "tests/recording/mcap_files.h"

namespace secondskin::recording {
namespace {

using testing::bytes;
using testing::contents;
using ::testing::HasSubstr;
using testing::kEpoch;
using testing::TemporaryFolder;

constexpr std::int64_t kMillisecond = 1'000'000;

std::size_t count_records(const std::filesystem::path& file, std::uint8_t code) {
  std::size_t count = 0;
  // Walks to the end of a file that is still being written: every record in it is whole.
  auto all = contents(file);
  all.resize(all.size() + 8);
  for (const auto& record : testing::outer_records(all)) count += record.code == code;
  return count;
}

// The check value that every catalogue of CRCs lists for CRC-32/ISO-HDLC.
TEST(Crc32, HasTheCatalogueValue) {
  EXPECT_EQ(mcap::crc32(0, mcap::bytes_of("123456789")), 0xCBF43926u);
}

TEST(Crc32, IsTheSameWhetherTakenWholeOrInParts) {
  const auto data = bytes(7, 100);
  for (std::size_t size = 0; size <= data.size(); ++size) {
    std::uint32_t bitwise = ~0u;
    for (std::size_t i = 0; i < size; ++i) {
      bitwise ^= data[i];
      for (int bit = 0; bit < 8; ++bit)
        bitwise = (bitwise >> 1) ^ ((bitwise & 1) ? 0xEDB88320u : 0);
    }
    const mcap::Bytes all(data.data(), size);
    ASSERT_EQ(mcap::crc32(0, all), ~bitwise);
    ASSERT_EQ(mcap::crc32(mcap::crc32(0, all.first(size / 3)), all.subspan(size / 3)), ~bitwise);
  }
}

TEST(McapWriter, RefusesToOverwriteAFile) {
  const TemporaryFolder folder;
  testing::write_contents(folder / "kept.mcap", {1, 2, 3});
  try {
    McapWriter writer(folder / "kept.mcap");
    FAIL() << "it was overwritten";
  } catch (const std::system_error& error) {
    EXPECT_EQ(error.code(), std::errc::file_exists);
    EXPECT_THAT(error.what(), HasSubstr("kept.mcap"));
  }
  EXPECT_EQ(contents(folder / "kept.mcap"), (std::vector<std::uint8_t>{1, 2, 3}));
}

TEST(McapWriter, NamesTheFileWhoseFolderIsMissing) {
  const TemporaryFolder folder;
  try {
    McapWriter writer(folder / "missing/session.mcap");
    FAIL() << "there is no such folder";
  } catch (const std::system_error& error) {
    EXPECT_EQ(error.code(), std::errc::no_such_file_or_directory);
    EXPECT_THAT(error.what(), HasSubstr("missing/session.mcap"));
  }
}

TEST(McapWriter, StoresAChunkOnceItsOldestMessageIsHalfASecondOld) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  McapWriter writer(file);
  const auto channel = writer.add_channel("a", "A", "omgidl", "struct A {};");
  writer.write(channel, 0, kEpoch, kEpoch, bytes(0, 10));
  writer.write(channel, 1, kEpoch + 400 * kMillisecond, kEpoch, bytes(1, 10));
  writer.flush_if_due(kEpoch + 499 * kMillisecond);
  EXPECT_EQ(count_records(file, 0x06), 0u);
  writer.flush_if_due(kEpoch + 500 * kMillisecond);
  EXPECT_EQ(count_records(file, 0x06), 1u);
  EXPECT_EQ(McapReader(file).messages(), 2u);

  // Without a call in between, the next message stores the chunk before it and opens its own.
  writer.write(channel, 2, kEpoch + 600 * kMillisecond, kEpoch, bytes(2, 10));
  writer.write(channel, 3, kEpoch + 1101 * kMillisecond, kEpoch, bytes(3, 10));
  EXPECT_EQ(McapReader(file).messages(), 3u);
}

TEST(McapWriter, StoresAChunkInTimeThoughTheWallClockWasSetBack) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  McapWriter writer(file, {.chunk_seconds = 0.02});
  const auto channel = writer.add_channel("a", "A", "omgidl", "struct A {};");
  writer.write(channel, 0, kEpoch, kEpoch, bytes(0, 10));
  std::this_thread::sleep_for(std::chrono::milliseconds(25));
  writer.flush_if_due(kEpoch - 3'600'000 * kMillisecond);
  EXPECT_EQ(McapReader(file).messages(), 1u);
}

TEST(McapWriter, StoresAChunkOnceItIsFull) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  McapWriter writer(file, {.chunk_bytes = 4096, .chunk_seconds = 60});
  const auto channel = writer.add_channel("a", "A", "omgidl", "struct A {};");
  for (std::uint32_t i = 0; i < 3; ++i) writer.write(channel, i, kEpoch, kEpoch, bytes(i, 1000));
  EXPECT_EQ(count_records(file, 0x06), 0u);
  writer.write(channel, 3, kEpoch, kEpoch, bytes(3, 1000));
  EXPECT_EQ(count_records(file, 0x06), 1u);
}

TEST(McapWriter, HandsEachChunkToTheKernelInOneCall) {
  const auto calls = []() -> std::optional<std::uint64_t> {
    std::ifstream io("/proc/self/io");
    for (std::string key; io >> key;) {
      std::uint64_t value = 0;
      io >> value;
      if (key == "syscw:") return value;
    }
    return std::nullopt;
  };
  if (!calls()) GTEST_SKIP() << "this kernel does not count system calls in /proc/self/io";
  const TemporaryFolder folder;
  McapWriter writer(folder / "session.mcap", {.chunk_bytes = 1000, .chunk_seconds = 60});
  const auto a = writer.add_channel("a", "A", "omgidl", "struct A {};");
  const auto b = writer.add_channel("b", "B", "omgidl", "struct B {};");
  const std::uint64_t before = *calls();
  for (std::uint32_t i = 0; i < 20; ++i) {
    writer.write(i % 2 == 0 ? a : b, i, kEpoch, kEpoch, bytes(i, 600));
  }
  EXPECT_EQ(*calls() - before, 10u);
}

TEST(McapWriter, KeepsSchemaTextsToTheByte) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  std::stringstream idl;
  idl << std::ifstream(SECONDSKIN_SOURCE_DIR "/idl/secondskin_msgs.idl").rdbuf();
  ASSERT_FALSE(idl.str().empty());
  const std::string odd = "struct A {};\r\n// \xC3\xA4 \0 end";
  {
    McapWriter writer(file);
    writer.add_channel("pose", "secondskin_msgs::msg::SkeletonPose", "omgidl", idl.str());
    writer.add_channel("raw", "secondskin_msgs::msg::ProjectorValues", "omgidl", idl.str());
    writer.add_channel("odd", "A", "omgidl", odd);
    writer.add_channel("plain", "", "", "", "json");
    writer.close();
  }
  McapReader reader(file);
  ASSERT_EQ(reader.channels().size(), 4u);
  EXPECT_EQ(reader.find("pose")->schema_text, idl.str());
  EXPECT_EQ(reader.find("pose")->schema_name, "secondskin_msgs::msg::SkeletonPose");
  EXPECT_EQ(reader.find("pose")->schema_encoding, "omgidl");
  EXPECT_EQ(reader.find("raw")->schema_text, idl.str());
  EXPECT_EQ(reader.find("raw")->message_encoding, "cdr");
  EXPECT_EQ(reader.find("odd")->schema_text, odd);
  EXPECT_EQ(reader.find("plain")->schema_encoding, "");
  EXPECT_EQ(reader.find("plain")->message_encoding, "json");
}

TEST(McapWriter, TakesTheLogTimeWhereNoPublishTimeIsKnown) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  McapWriter writer(file);
  writer.write(writer.add_channel("a", "A", "omgidl", "struct A {};"), 0, kEpoch, -1, {});
  writer.close();
  McapReader reader(file);
  ASSERT_EQ(testing::messages_of(reader).size(), 1u);
  EXPECT_EQ(testing::messages_of(reader)[0].publish_time_ns, kEpoch);
}

TEST(McapWriter, RefusesWhatCannotBeReadBack) {
  const TemporaryFolder folder;
  McapWriter writer(folder / "session.mcap");
  const auto channel = writer.add_channel("a", "A", "omgidl", "struct A {};");
  EXPECT_THROW(writer.write(0, 0, kEpoch, kEpoch, {}), std::invalid_argument);
  EXPECT_THROW(writer.write(static_cast<std::uint16_t>(channel + 1), 0, kEpoch, kEpoch, {}),
               std::invalid_argument);
  EXPECT_THROW(writer.write(channel, 0, -1, 0, {}), std::invalid_argument);
  EXPECT_THROW(writer.write(channel, 0, kEpoch, 0, std::vector<std::uint8_t>((64u << 20) + 1)),
               std::invalid_argument);
  EXPECT_THROW(McapWriter(folder / "b.mcap", {.chunk_seconds = -1}), std::invalid_argument);
  EXPECT_THROW(McapWriter(folder / "b.mcap", {.chunk_bytes = 1u << 30}), std::invalid_argument);
  EXPECT_FALSE(std::filesystem::exists(folder / "b.mcap"));
}

TEST(McapWriter, ClosesOnceAndThenRefusesMore) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  McapWriter writer(file);
  const auto channel = writer.add_channel("a", "A", "omgidl", "struct A {};");
  writer.write(channel, 0, kEpoch, kEpoch, bytes(0, 10));
  writer.close();
  EXPECT_EQ(writer.stored_bytes(), std::filesystem::file_size(file));
  const auto stored = contents(file);
  writer.close();
  EXPECT_EQ(writer.messages(), 1u);
  EXPECT_THROW(writer.write(channel, 1, kEpoch, kEpoch, {}), std::system_error);
  EXPECT_THROW(writer.write_metadata("late", {}), std::system_error);
  EXPECT_THROW(writer.write_attachment("late", "text/plain", 0, {}), std::system_error);
  EXPECT_EQ(contents(file), stored);
}

TEST(McapWriter, FinishesItsFileWhenItIsDestroyedOrAssignedAnother) {
  const TemporaryFolder folder;
  {
    McapWriter writer(folder / "first.mcap");
    writer.write(writer.add_channel("a", "A", "omgidl", "struct A {};"), 0, kEpoch, kEpoch, {});
    writer = McapWriter(folder / "second.mcap");
    EXPECT_TRUE(McapReader(folder / "first.mcap").finished());
    EXPECT_FALSE(McapReader(folder / "second.mcap").finished());
  }
  EXPECT_TRUE(McapReader(folder / "second.mcap").finished());
  EXPECT_EQ(McapReader(folder / "first.mcap").messages(), 1u);
}

TEST(McapWriter, LeavesNoReservedBlocksBehind) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  McapWriter writer(file);
  writer.write(writer.add_channel("a", "A", "omgidl", "struct A {};"), 0, kEpoch, kEpoch, {});
  writer.close();
  struct stat status {};
  ASSERT_EQ(::stat(file.c_str(), &status), 0);
  EXPECT_LT(status.st_blocks * 512, 64 * 1024);
}

}  // namespace
}  // namespace secondskin::recording
