#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <random>
#include <system_error>

#include "recording/mcap_format.h"
#include "recording/mcap_reader.h"
#include "tests/recording/mcap_files.h"

namespace secondskin::recording {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::largest_request;
using testing::make_recording;
using testing::Message;
using testing::messages_of;
using testing::outer_records;
using testing::Recording;
using testing::TemporaryFolder;
using testing::write_contents;

std::vector<Message> without_chunk(const Recording& recording,
                                   std::optional<std::size_t> left_out) {
  std::vector<Message> all;
  for (std::size_t i = 0; i < recording.chunks.size(); ++i) {
    if (i == left_out) continue;
    all.insert(all.end(), recording.chunks[i].begin(), recording.chunks[i].end());
  }
  return all;
}

/// What a writer that was killed leaves: no summary.
std::vector<std::uint8_t> unfinished(const Recording& recording) {
  auto file = recording.file;
  for (const auto& record : outer_records(file)) {
    if (record.code == 0x0F) file.resize(record.at);
    if (record.at >= file.size()) break;
  }
  return file;
}

std::uint64_t offset_of(const std::vector<std::uint8_t>& file, std::uint8_t code,
                        std::size_t which) {
  auto padded = file;
  padded.resize(file.size() + 8);
  for (const auto& record : outer_records(padded)) {
    if (record.code == code && which-- == 0) return record.at;
  }
  throw std::out_of_range("no such record");
}

TEST(DamagedRecording, CutAtAnyByteYieldsExactlyItsWholeChunks) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 6, 5, 40);
  ASSERT_EQ(recording.chunk_ends.size(), 6u);
  const std::uint64_t header_end = outer_records(recording.file).front().end;
  const auto file = folder / "cut.mcap";
  for (std::size_t size = 0; size < recording.file.size(); ++size) {
    write_contents(file,
                   {recording.file.begin(), recording.file.begin() + static_cast<long>(size)});
    if (size < header_end) {
      ASSERT_THROW(McapReader reader(file), McapError) << "cut at " << size;
      continue;
    }
    McapReader reader(file);
    ASSERT_FALSE(reader.finished()) << "cut at " << size;
    std::vector<Message> expected;
    for (std::size_t i = 0; i < recording.chunks.size() && recording.chunk_ends[i] <= size; ++i) {
      expected.insert(expected.end(), recording.chunks[i].begin(), recording.chunks[i].end());
    }
    ASSERT_EQ(messages_of(reader), expected) << "cut at " << size;
    ASSERT_EQ(reader.messages(), expected.size()) << "cut at " << size;
    ASSERT_LE(reader.attachments().size(), 1u);
  }
}

/// Changes `flips` bytes at random, `rounds` times, and reads. With one flip, at most one chunk may
/// be missing, never silently, and no message may differ.
void flip_and_read(const Recording& recording, const std::vector<std::uint8_t>& file, int rounds,
                   int flips, unsigned seed) {
  const TemporaryFolder folder;
  const auto path = folder / "flipped.mcap";
  const auto everything = without_chunk(recording, {});
  std::mt19937 random(seed);
  int lost_chunks = 0;
  largest_request = 0;
  for (int round = 0; round < rounds; ++round) {
    auto flipped = file;
    std::string where;
    for (int i = 0; i < flips; ++i) {
      const std::size_t at = random() % flipped.size();
      const auto before = flipped[at];
      while (flipped[at] == before) flipped[at] = static_cast<std::uint8_t>(random());
      where += fmt::format("{}:{} ", at, flipped[at]);
    }
    write_contents(path, flipped);
    try {
      McapReader reader(path);
      const auto found = messages_of(reader);
      reader.attachments();
      if (flips > 1) continue;
      if (found == everything) continue;
      bool one_missing = false;
      for (std::size_t i = 0; i < recording.chunks.size() && !one_missing; ++i) {
        one_missing = found == without_chunk(recording, i);
      }
      ASSERT_TRUE(one_missing) << found.size() << " of " << everything.size() << " messages, "
                               << where;
      ASSERT_THAT(reader.damage(), Not(IsEmpty())) << where;
      ++lost_chunks;
    } catch (const McapError&) {
      // Only the first eight bytes decide whether it is an MCAP file.
      if (flips == 1) {
        ASSERT_LT(std::stoul(where), 8u);
      }
    }
  }
  if (flips == 1) {
    EXPECT_GT(lost_chunks, rounds / 10) << "the flips missed the chunks";
  }
  EXPECT_LT(largest_request, 1u << 20);
}

TEST(DamagedRecording, LosesAtMostAChunkToAFlippedByteAndSaysSo) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 8, 12, 100);
  flip_and_read(recording, recording.file, 4000, 1, 1);
}

TEST(DamagedRecording, LosesAtMostAChunkToAFlippedByteWithoutAnIndexToo) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 8, 12, 100);
  flip_and_read(recording, unfinished(recording), 4000, 1, 2);
}

TEST(DamagedRecording, SurvivesManyFlippedBytes) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 8, 12, 100);
  flip_and_read(recording, recording.file, 1000, 5, 3);
  flip_and_read(recording, unfinished(recording), 1000, 5, 4);
  flip_and_read(recording, recording.file, 500, 60, 5);
  flip_and_read(recording, unfinished(recording), 500, 60, 6);
}

TEST(DamagedRecording, LeavesOutAChunkOfWrongCrcAndSaysWhere) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 4, 20, 100);
  auto file = recording.file;
  const std::uint64_t at = offset_of(file, 0x06, 2);
  file[recording.chunk_ends[2] - 20] ^= 0xFF;
  write_contents(folder / "flipped.mcap", file);
  McapReader reader(folder / "flipped.mcap");
  EXPECT_THAT(reader.damage(), IsEmpty());  // by index nobody has looked at the chunk yet
  EXPECT_EQ(messages_of(reader), without_chunk(recording, 2));
  EXPECT_EQ(messages_of(reader), without_chunk(recording, 2));
  EXPECT_THAT(reader.damage(),
              ElementsAre(HasSubstr("offset " + std::to_string(at) + ": chunk left out")));

  file.resize(unfinished(recording).size());
  write_contents(folder / "scanned.mcap", file);
  McapReader scanned(folder / "scanned.mcap");
  EXPECT_THAT(scanned.damage(),
              ElementsAre(HasSubstr("offset " + std::to_string(at) + ": chunk left out")));
  EXPECT_EQ(scanned.messages(), 60u);
  EXPECT_EQ(messages_of(scanned), without_chunk(recording, 2));
}

TEST(DamagedRecording, KnowsItsChannelsThoughTheFirstChunkIsLost) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 4, 20, 100);
  auto file = unfinished(recording);
  file[recording.chunk_ends[0] - 20] ^= 0xFF;
  write_contents(folder / "flipped.mcap", file);
  McapReader reader(folder / "flipped.mcap");
  EXPECT_EQ(messages_of(reader), without_chunk(recording, 0));
  EXPECT_EQ(reader.find("/a")->schema_name, "test::A");
}

TEST(DamagedRecording, FindsTheChunksBehindALengthThatIsWrong) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 4, 20, 100);
  for (const std::uint8_t high : {0x01, 0x40, 0xFF}) {
    auto file = unfinished(recording);
    const std::uint64_t at = offset_of(file, 0x06, 1);
    file[at + 3] ^= high;
    write_contents(folder / "flipped.mcap", file);
    McapReader reader(folder / "flipped.mcap");
    EXPECT_EQ(messages_of(reader), without_chunk(recording, 1));
    EXPECT_THAT(reader.damage(), ElementsAre(HasSubstr("offset " + std::to_string(at))));
  }
}

TEST(DamagedRecording, TakesNoMessageIndexForAMessage) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 4, 20, 100);
  auto file = unfinished(recording);
  file[offset_of(file, 0x07, 2)] = 0x05;
  write_contents(folder / "flipped.mcap", file);
  McapReader reader(folder / "flipped.mcap");
  EXPECT_EQ(messages_of(reader), without_chunk(recording, {}));
}

TEST(DamagedRecording, BelievesNoChunkThatClaimsToBeHuge) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 3, 20, 100);
  for (const std::uint64_t claim : {std::uint64_t{1} << 62, std::uint64_t{1} << 40,
                                    mcap::kMostUnpacked, std::uint64_t{1} << 21}) {
    auto file = unfinished(recording);
    const std::uint64_t at = offset_of(file, 0x06, 1);
    std::memcpy(file.data() + at + 9 + 16, &claim, sizeof claim);
    write_contents(folder / "huge.mcap", file);
    largest_request = 0;
    McapReader reader(folder / "huge.mcap");
    EXPECT_LT(largest_request, 1u << 20) << claim;
    EXPECT_EQ(messages_of(reader), without_chunk(recording, 1));
  }
}

TEST(DamagedRecording, LeavesOutAnAttachmentOfWrongCrc) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 3, 20, 100);
  auto file = recording.file;
  const std::string_view note = "a note";
  const auto place = std::search(file.begin(), file.end(), note.begin(), note.end());
  ASSERT_NE(place, file.end());
  *place = 'A';
  write_contents(folder / "flipped.mcap", file);
  McapReader reader(folder / "flipped.mcap");
  EXPECT_THAT(reader.attachments(), IsEmpty());
  EXPECT_THAT(reader.attachments(), IsEmpty());
  EXPECT_THAT(reader.damage(), ElementsAre(HasSubstr("attachment \"note.txt\" left out")));
}

TEST(Repair, MakesAFinishedFileOfACutOne) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 4, 20, 100);
  auto file = recording.file;
  file.resize(recording.chunk_ends[2] + 3);
  write_contents(folder / "cut.mcap", file);
  EXPECT_EQ(repair(folder / "cut.mcap", folder / "repaired.mcap"), 60u);
  EXPECT_EQ(testing::contents(folder / "cut.mcap"), file);

  McapReader reader(folder / "repaired.mcap");
  EXPECT_TRUE(reader.finished());
  EXPECT_THAT(reader.damage(), IsEmpty());
  EXPECT_EQ(messages_of(reader), without_chunk(recording, 3));
  EXPECT_EQ(reader.metadata().at("session_settings").at("subject"), "anna");
  ASSERT_EQ(reader.attachments().size(), 1u);
  EXPECT_EQ(reader.attachments()[0].name, "note.txt");
  EXPECT_EQ(reader.find("/b")->schema_text, "struct B { long y; };");
}

TEST(Repair, NeverOverwrites) {
  const TemporaryFolder folder;
  const Recording recording = make_recording(folder / "whole.mcap", 1, 5, 10);
  EXPECT_THROW(repair(folder / "whole.mcap", folder / "whole.mcap"), std::system_error);
  EXPECT_EQ(testing::contents(folder / "whole.mcap"), recording.file);
}

}  // namespace
}  // namespace secondskin::recording
