#include "recording/mcap_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <lz4frame.h>

#include <algorithm>
#include <fstream>
#include <random>

#include "recording/mcap_format.h"
#include "tests/recording/mcap_files.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr bool kSanitized = true;
#else
constexpr bool kSanitized = false;
#endif

namespace secondskin::recording {
namespace {

using mcap::Encoder;
using mcap::Op;
using testing::bytes;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::kEpoch;
using testing::Message;
using testing::messages_of;
using testing::TemporaryFolder;

std::vector<Message> flat(const testing::Recording& recording) {
  std::vector<Message> all;
  for (const auto& chunk : recording.chunks) all.insert(all.end(), chunk.begin(), chunk.end());
  return all;
}

/// Files as other writers make them, built record by record.
class ForeignFile {
 public:
  ForeignFile() {
    out_.raw(mcap::kMagic);
    record(Op::kHeader, [](Encoder& e) {
      e.string("");
      e.string("another writer");
    });
  }
  template <typename Fill>
  static void record_into(Encoder& out, Op op, Fill fill) {
    const std::size_t content = out.open_record(op);
    fill(out);
    out.close_record(content);
  }
  template <typename Fill>
  void record(Op op, Fill fill) {
    record_into(out_, op, fill);
  }
  static void channel_into(Encoder& out) {
    record_into(out, Op::kSchema, [](Encoder& e) {
      e.number(std::uint16_t{9});
      e.string("A");
      e.string("jsonschema");
      e.string("{}");
    });
    record_into(out, Op::kChannel, [](Encoder& e) {
      e.number(std::uint16_t{0});  // 0 is a channel like any other
      e.number(std::uint16_t{9});
      e.string("topic");
      e.string("json");
      e.string("");
    });
  }
  static void message_into(Encoder& out, std::uint64_t time, std::uint8_t data) {
    record_into(out, Op::kMessage, [&](Encoder& e) {
      e.number(std::uint16_t{0});
      e.number(std::uint32_t{data});
      e.number(time);
      e.number(time);
      e.number(data);
    });
  }
  void chunk(const Encoder& records, std::string_view compression,
             const std::vector<std::uint8_t>& data, std::uint64_t start, std::uint64_t end,
             std::uint32_t crc) {
    record(Op::kChunk, [&](Encoder& e) {
      e.number(start);
      e.number(end);
      e.number(std::uint64_t{records.out.size()});
      e.number(crc);
      e.string(compression);
      e.number(std::uint64_t{data.size()});
      e.raw(data);
    });
  }
  Encoder& out() { return out_; }
  void finish_without_summary() {
    record(Op::kDataEnd, [](Encoder& e) { e.number(std::uint32_t{0}); });
    record(Op::kFooter, [](Encoder& e) {
      e.number(std::uint64_t{0});
      e.number(std::uint64_t{0});
      e.number(std::uint32_t{0});
    });
    out_.raw(mcap::kMagic);
  }
  void store(const std::filesystem::path& file) { testing::write_contents(file, out_.out); }

 private:
  Encoder out_;
};

TEST(McapReader, YieldsWhatWasWritten) {
  const TemporaryFolder folder;
  const auto recording = testing::make_recording(folder / "session.mcap", 5, 40, 100);
  McapReader reader(folder / "session.mcap");
  EXPECT_TRUE(reader.finished());
  EXPECT_THAT(reader.damage(), IsEmpty());
  EXPECT_EQ(reader.messages(), 200u);
  EXPECT_EQ(reader.start_ns(), kEpoch);
  EXPECT_EQ(reader.end_ns(), kEpoch + 199 * 1'000'000LL);
  EXPECT_EQ(messages_of(reader), flat(recording));
  ASSERT_EQ(reader.channels().size(), 2u);
  EXPECT_EQ(reader.find("/a")->messages + reader.find("/b")->messages, 200u);
  EXPECT_EQ(reader.find("/b")->schema_name, "test::B");
  EXPECT_FALSE(reader.find("/c"));
  EXPECT_EQ(reader.metadata().at("session_settings").at("rate_hz"), "62.5");
  ASSERT_EQ(reader.attachments().size(), 1u);
  EXPECT_EQ(reader.attachments()[0].name, "note.txt");
  EXPECT_EQ(reader.attachments()[0].media_type, "text/plain");
  EXPECT_EQ(reader.attachments()[0].log_time_ns, kEpoch);
  EXPECT_THAT(reader.attachments()[0].data, ElementsAre('a', ' ', 'n', 'o', 't', 'e'));
}

TEST(McapReader, TellsTheSameByScanningAsByIndex) {
  const TemporaryFolder folder;
  const auto recording = testing::make_recording(folder / "session.mcap", 5, 40, 100);
  auto cut = recording.file;
  cut.resize(cut.size() - 1);
  testing::write_contents(folder / "cut.mcap", cut);
  McapReader whole(folder / "session.mcap");
  McapReader scanned(folder / "cut.mcap");
  EXPECT_FALSE(scanned.finished());
  EXPECT_THAT(scanned.damage(), IsEmpty());  // all of the data section is there
  EXPECT_EQ(scanned.messages(), whole.messages());
  EXPECT_EQ(scanned.start_ns(), whole.start_ns());
  EXPECT_EQ(scanned.end_ns(), whole.end_ns());
  EXPECT_EQ(scanned.metadata(), whole.metadata());
  EXPECT_EQ(scanned.attachments().size(), 1u);
  EXPECT_EQ(messages_of(scanned), messages_of(whole));
  ASSERT_EQ(scanned.channels().size(), whole.channels().size());
  for (std::size_t i = 0; i < whole.channels().size(); ++i) {
    EXPECT_EQ(scanned.channels()[i].topic, whole.channels()[i].topic);
    EXPECT_EQ(scanned.channels()[i].messages, whole.channels()[i].messages);
    EXPECT_EQ(scanned.channels()[i].schema_text, whole.channels()[i].schema_text);
  }
}

TEST(McapReader, MergesOverlappingChunksInOrderOfLogTime) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  std::mt19937 random(1);
  std::vector<Message> expected;
  {
    McapWriter writer(file, {.chunk_bytes = 2000, .chunk_seconds = 3600});
    const auto a = writer.add_channel("a", "A", "omgidl", "struct A {};");
    const auto b = writer.add_channel("b", "B", "omgidl", "struct B {};");
    for (std::uint32_t i = 0; i < 2000; ++i) {
      // Up to 300 places out of order, and about every third time shared with another.
      const std::int64_t time = kEpoch + (i + random() % 300) / 3 * 1000;
      writer.write(i % 2 == 0 ? a : b, i, time, time + 5, bytes(i, 50));
      expected.push_back({i % 2 == 0 ? "a" : "b", i, time, time + 5, bytes(i, 50)});
    }
    writer.close();
  }
  std::stable_sort(expected.begin(), expected.end(), [](const Message& x, const Message& y) {
    return x.log_time_ns < y.log_time_ns;
  });
  McapReader reader(file);
  EXPECT_EQ(messages_of(reader), expected);

  const std::int64_t middle = expected[1000].log_time_ns;
  expected.erase(std::remove_if(expected.begin(), expected.end(),
                                [&](const Message& m) { return m.log_time_ns < middle; }),
                 expected.end());
  EXPECT_EQ(messages_of(reader, middle), expected);
}

TEST(McapReader, EndsWhenTheVisitorWantsNoMore) {
  const TemporaryFolder folder;
  testing::make_recording(folder / "session.mcap", 3, 10, 20);
  McapReader reader(folder / "session.mcap");
  int seen = 0;
  reader.for_each([&](const McapMessage&) { return ++seen < 4; });
  EXPECT_EQ(seen, 4);
}

TEST(McapReader, OpensARecordingThatHoldsNothing) {
  const TemporaryFolder folder;
  McapWriter(folder / "empty.mcap").close();
  McapReader reader(folder / "empty.mcap");
  EXPECT_TRUE(reader.finished());
  EXPECT_EQ(reader.messages(), 0u);
  EXPECT_EQ(reader.start_ns(), 0);
  EXPECT_THAT(messages_of(reader), IsEmpty());
  EXPECT_THAT(reader.damage(), IsEmpty());
}

TEST(McapReader, SaysWhatItFoundWhereNoRecordingIs) {
  const TemporaryFolder folder;
  testing::write_contents(folder / "short.mcap", {0x89, 'M', 'C'});
  testing::write_contents(folder / "text.mcap", {'H', 'I', 'E', 'R', 'A', 'R', 'C', 'H', 'Y'});
  testing::write_contents(folder / "magic.mcap", {0x89, 'M', 'C', 'A', 'P', '0', '\r', '\n'});
  const auto reason = [&](std::string_view name) -> std::string {
    try {
      McapReader reader(folder / name);
      return "";
    } catch (const McapError& error) {
      return error.what();
    }
  };
  EXPECT_THAT(reason("short.mcap"),
              HasSubstr("short.mcap: offset 0: found a file of fewer than 8"));
  EXPECT_THAT(reason("text.mcap"), HasSubstr("found 48 49 45 52 41 52 43 48, expected"));
  EXPECT_THAT(reason("magic.mcap"), HasSubstr("offset 8: found no readable record"));
  EXPECT_THAT(reason("missing.mcap"), HasSubstr("No such file"));
  EXPECT_THAT(reason(""), HasSubstr("expected a file"));
}

TEST(McapReader, ReadsMessagesOutsideOfChunks) {
  const TemporaryFolder folder;
  ForeignFile file;
  ForeignFile::channel_into(file.out());
  for (std::uint8_t i = 0; i < 100; ++i) ForeignFile::message_into(file.out(), 1000u - i, i);
  file.finish_without_summary();
  file.store(folder / "loose.mcap");
  McapReader reader(folder / "loose.mcap");
  EXPECT_TRUE(reader.finished());
  EXPECT_THAT(reader.damage(), IsEmpty());
  EXPECT_EQ(reader.messages(), 100u);
  EXPECT_EQ(reader.start_ns(), 901);
  EXPECT_EQ(reader.channels().at(0).schema_encoding, "jsonschema");
  const auto messages = messages_of(reader);
  ASSERT_EQ(messages.size(), 100u);
  EXPECT_EQ(messages.front().sequence, 99u);
  EXPECT_THAT(messages.back().data, ElementsAre(0));
}

TEST(McapReader, ReadsLz4AndUncompressedChunks) {
  const TemporaryFolder folder;
  ForeignFile file;
  Encoder first;
  ForeignFile::channel_into(first);
  for (std::uint8_t i = 0; i < 50; ++i) ForeignFile::message_into(first, 10u + i, i);
  file.chunk(first, "", first.out, 10, 59, 0);  // no CRC
  Encoder second;
  for (std::uint8_t i = 50; i < 100; ++i) ForeignFile::message_into(second, 10u + i, i);
  std::vector<std::uint8_t> packed(LZ4F_compressFrameBound(second.out.size(), nullptr));
  packed.resize(LZ4F_compressFrame(packed.data(), packed.size(), second.out.data(),
                                   second.out.size(), nullptr));
  file.chunk(second, "lz4", packed, 60, 109, mcap::crc32(0, second.out));
  file.finish_without_summary();
  file.store(folder / "mixed.mcap");
  McapReader reader(folder / "mixed.mcap");
  EXPECT_THAT(reader.damage(), IsEmpty());
  const auto messages = messages_of(reader);
  ASSERT_EQ(messages.size(), 100u);
  for (std::uint8_t i = 0; i < 100; ++i) EXPECT_THAT(messages[i].data, ElementsAre(i));
}

TEST(McapReader, UnpacksNoMoreThanItSaysItWill) {
  const TemporaryFolder folder;
  ForeignFile file;
  Encoder records;
  ForeignFile::channel_into(records);
  file.chunk(records, "", records.out, 0, 0, 0);
  // lz4 frames need not say how much they hold, so nothing but the limit speaks against this one.
  file.record(Op::kChunk, [&](Encoder& e) {
    e.number(std::uint64_t{1});
    e.number(std::uint64_t{1});
    e.number(mcap::kMostUnpacked + 1);
    e.number(std::uint32_t{1});
    e.string("lz4");
    e.number(std::uint64_t{4});
    e.number(std::uint32_t{0x184D2204});
  });
  file.finish_without_summary();
  file.store(folder / "huge.mcap");
  McapReader reader(folder / "huge.mcap");
  EXPECT_THAT(reader.damage(), ElementsAre(HasSubstr("expected at most 268435456")));
}

TEST(McapReader, PassesOverRecordsItDoesNotKnow) {
  const TemporaryFolder folder;
  ForeignFile file;
  file.record(static_cast<Op>(0x80), [](Encoder& e) { e.string("a company's own"); });
  ForeignFile::channel_into(file.out());
  file.record(static_cast<Op>(0x42), [](Encoder& e) { e.string("of a later version"); });
  ForeignFile::message_into(file.out(), 1, 1);
  file.finish_without_summary();
  file.store(folder / "later.mcap");
  McapReader reader(folder / "later.mcap");
  EXPECT_THAT(reader.damage(), IsEmpty());
  EXPECT_EQ(reader.messages(), 1u);
}

TEST(McapReader, LeavesOutMessagesWhoseChannelTheFileDoesNotDescribe) {
  const TemporaryFolder folder;
  ForeignFile file;
  ForeignFile::message_into(file.out(), 1, 1);
  file.finish_without_summary();
  file.store(folder / "stranger.mcap");
  McapReader reader(folder / "stranger.mcap");
  EXPECT_EQ(reader.messages(), 0u);
  EXPECT_THAT(reader.damage(), ElementsAre(HasSubstr("1 messages of channels")));
}

TEST(McapReader, HoldsOnlyAFewChunksInMemory) {
  if (kSanitized) GTEST_SKIP() << "sanitizers keep freed memory, so the peak says nothing";
  const TemporaryFolder folder;
  const auto file = folder / "large.mcap";
  constexpr std::uint32_t kMessages = 96;
  {
    std::mt19937_64 random(3);
    McapWriter writer(file);
    const auto channel = writer.add_channel("a", "A", "omgidl", "struct A {};");
    std::vector<std::uint64_t> noise((1 << 20) / 8);
    for (std::uint32_t i = 0; i < kMessages; ++i) {
      for (auto& word : noise) word = random();
      writer.write(channel, i, kEpoch + i, kEpoch,
                   {reinterpret_cast<const std::uint8_t*>(noise.data()), noise.size() * 8});
    }
    writer.close();
  }
  ASSERT_GT(std::filesystem::file_size(file), 96u << 20);
  const auto peak_kib = [] {
    std::ifstream status("/proc/self/status");
    for (std::string word; status >> word;) {
      if (word == "VmHWM:") {
        std::uint64_t value = 0;
        status >> value;
        return value;
      }
    }
    return std::uint64_t{0};
  };
  std::ofstream("/proc/self/clear_refs") << "5";  // forgets the peak
  const std::uint64_t before = peak_kib();
  McapReader reader(file);
  std::uint32_t seen = 0;
  reader.for_each([&](const McapMessage&) { return ++seen > 0; });
  EXPECT_EQ(seen, kMessages);
  EXPECT_LT(peak_kib() - before, 16u << 10);
}

}  // namespace
}  // namespace secondskin::recording
