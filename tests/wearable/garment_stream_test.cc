#include "wire/garment_stream.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

namespace secondskin::wire {
namespace {

using ::testing::ElementsAre;

GarmentStreamHeader small() {
  GarmentStreamHeader header;
  header.garment = "small";
  header.boards = 2;
  header.sources = 3;
  header.slot_samples = 20;
  header.start_ns = 1'700'000'000'000'000'000;
  header.sample_rate_hz = 140e3;
  header.inertial_rate_hz = 140.0;
  header.carrier_hz = 40e3;
  header.temperature = 21.5;
  return header;
}

std::vector<std::int16_t> samples_of(const GarmentStreamHeader& header, std::uint32_t sequence) {
  std::mt19937 random(sequence);
  std::vector<std::int16_t> samples(static_cast<std::size_t>(header.boards) * header.slot_samples);
  for (auto& sample : samples) sample = static_cast<std::int16_t>(random());
  return samples;
}

std::vector<std::uint8_t> stream(const GarmentStreamHeader& header, std::uint32_t slots) {
  std::vector<std::uint8_t> bytes;
  for (std::uint32_t k = 0; k < slots; ++k) append_slot(header, k, samples_of(header, k), bytes);
  return bytes;
}

struct Read {
  std::vector<std::uint32_t> sequences;
  GarmentStreamCounters counters;
  std::optional<GarmentStreamHeader> header;
  bool wrong = false;  ///< a slot came with other samples than were sent
};

Read read(std::span<const std::uint8_t> bytes, std::size_t piece = 1000) {
  Read out;
  GarmentStreamReader reader;
  const auto sink = [&](const GarmentSlot& slot) {
    out.sequences.push_back(slot.sequence);
    const auto& header = *reader.header();
    out.wrong = out.wrong || slot.samples != samples_of(header, slot.sequence) ||
                slot.source != slot.sequence % header.sources ||
                slot.stamp_ns != header.stamp_ns(slot.sequence);
  };
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    reader.feed(bytes.subspan(at, std::min(piece, bytes.size() - at)), sink);
  }
  reader.finish(sink);
  out.counters = reader.counters();
  out.header = reader.header();
  return out;
}

TEST(GarmentStream, GivesBackWhatWasWrittenHoweverItIsCut) {
  const auto bytes = stream(small(), 70);
  for (const std::size_t piece : {1UL, 7UL, 99UL, 1000UL, 100000UL}) {
    const Read out = read(bytes, piece);
    ASSERT_TRUE(out.header);
    EXPECT_EQ(*out.header, small());
    EXPECT_EQ(out.sequences.size(), 70U);
    EXPECT_FALSE(out.wrong);
    EXPECT_EQ(out.counters.bytes, bytes.size());
    EXPECT_EQ(out.counters.lost + out.counters.garbled + out.counters.skipped_bytes, 0U);
  }
}

TEST(GarmentStream, StampsASlotByItsFirstSample) {
  // 1120 samples at 140 kHz are 8 ms (Practical Motion Capture, 4.1).
  GarmentStreamHeader header = small();
  header.slot_samples = 1120;
  EXPECT_EQ(header.stamp_ns(0), header.start_ns);
  EXPECT_EQ(header.stamp_ns(1'000'000) - header.start_ns, 8'000'000'000'000);
}

TEST(GarmentStream, FindsEveryGarbledByteAndLosesOneSlotAtMost) {
  const auto good = stream(small(), 3);
  std::mt19937 random(1);
  for (std::size_t at = 0; at < good.size(); ++at) {
    auto bytes = good;
    bytes[at] = static_cast<std::uint8_t>(bytes[at] ^ (1 + random() % 255));
    const Read out = read(bytes);
    EXPECT_FALSE(out.wrong) << at;
    if (at < kGarmentHeaderSize) {
      EXPECT_TRUE(out.sequences.empty()) << at;  // no header, no layout
    } else {
      EXPECT_EQ(out.sequences.size(), 2U) << at;
    }
    EXPECT_GT(out.counters.garbled + out.counters.skipped_bytes, 0U) << at;
    EXPECT_EQ(out.counters.skipped_bytes, at < kGarmentHeaderSize ? bytes.size() : 100U) << at;
  }
}

TEST(GarmentStream, ASlotThatIsNotThereIsCounted) {
  std::vector<std::uint8_t> bytes;
  for (const std::uint32_t k : {0U, 1U, 4U, 5U}) {
    append_slot(small(), k, samples_of(small(), k), bytes);
  }
  const Read out = read(bytes);
  EXPECT_THAT(out.sequences, ElementsAre(0, 1, 4, 5));
  EXPECT_EQ(out.counters.lost, 2U);
}

TEST(GarmentStream, JoinsAtAnyByteWithTheNextHeader) {
  const auto bytes = stream(small(), 130);
  for (const std::size_t from : {1UL, 79UL, 80UL, 500UL, 3333UL, 6480UL}) {
    const Read out = read(std::span(bytes).subspan(from));
    ASSERT_FALSE(out.sequences.empty());
    EXPECT_EQ(out.sequences.front(), 64U);
    EXPECT_EQ(out.sequences.size(), 66U);
    EXPECT_FALSE(out.wrong);
    EXPECT_EQ(out.counters.lost, 0U);
  }
}

TEST(GarmentStream, ATornFileGivesItsWholeSlots) {
  const auto bytes = stream(small(), 3);
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    const Read out = read(std::span(bytes).first(size));
    const std::size_t whole = size < kGarmentHeaderSize ? 0 : (size - kGarmentHeaderSize) / 100;
    EXPECT_EQ(out.sequences.size(), whole) << size;
    EXPECT_FALSE(out.wrong);
    const std::size_t used = size < kGarmentHeaderSize ? 0 : kGarmentHeaderSize + 100 * whole;
    EXPECT_EQ(out.counters.skipped_bytes, size - used);
  }
}

TEST(GarmentStream, SurvivesAnyBytes) {
  std::mt19937 random(2);
  for (int round = 0; round < 300; ++round) {
    auto bytes = stream(small(), 10);
    // Lose runs, put noise and false beginnings in.
    for (int k = 0; k < 4; ++k) {
      const auto at = static_cast<std::ptrdiff_t>(random() % bytes.size());
      const auto length = std::min<std::ptrdiff_t>(static_cast<std::ptrdiff_t>(random() % 150),
                                                   static_cast<std::ptrdiff_t>(bytes.size()) - at);
      if (k % 2 == 0) {
        bytes.erase(bytes.begin() + at, bytes.begin() + at + length);
      } else {
        const std::vector<std::uint8_t> fake{0xB5, 'S', 'L', 'T', 0, 0, 0, 0, 1, 0, 2, 0, 20, 0};
        bytes.insert(bytes.begin() + at, fake.begin(), fake.end());
      }
    }
    const Read whole = read(bytes, 1'000'000), pieces = read(bytes, 13);
    EXPECT_FALSE(whole.wrong);
    EXPECT_EQ(whole.sequences, pieces.sequences);
    EXPECT_EQ(whole.counters.skipped_bytes, pieces.counters.skipped_bytes);
    EXPECT_EQ(whole.counters.garbled, pieces.counters.garbled);
  }
}

TEST(GarmentStream, AHeaderOfAnotherLayoutIsNotFollowed) {
  auto bytes = stream(small(), 2);
  GarmentStreamHeader other = small();
  other.boards = 5;
  append_header(other, bytes);
  append_slot(small(), 2, samples_of(small(), 2), bytes);
  const Read out = read(bytes);
  EXPECT_EQ(out.sequences.size(), 3U);
  EXPECT_EQ(out.counters.foreign, 1U);
  EXPECT_EQ(out.header->boards, 2U);
}

TEST(GarmentStream, FollowsABoxThatWasStartedAnew) {
  auto bytes = stream(small(), 5);
  GarmentStreamHeader again = small();
  again.start_ns += 1'000'000'000;
  const auto more = stream(again, 3);
  bytes.insert(bytes.end(), more.begin(), more.end());
  const Read out = read(bytes);
  EXPECT_THAT(out.sequences, ElementsAre(0, 1, 2, 3, 4, 0, 1, 2));
  EXPECT_FALSE(out.wrong);
  EXPECT_EQ(out.counters.lost, 0U);
}

TEST(GarmentStream, RefusesWhatItCannotWrite) {
  std::vector<std::uint8_t> out;
  GarmentStreamHeader header = small();
  header.garment.assign(33, 'x');
  EXPECT_THROW(append_header(header, out), std::invalid_argument);
  header = small();
  header.boards = 65;
  EXPECT_THROW(append_header(header, out), std::invalid_argument);
  EXPECT_THROW(append_slot(small(), 0, std::vector<std::int16_t>(39), out), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::wire
