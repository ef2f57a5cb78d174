#include "sim/optical/virtual_tags.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <map>

#include "scenes.h"

namespace secondskin::sim {
namespace {

using Bytes = std::vector<std::uint8_t>;
using Set = std::vector<std::uint8_t>;

class SuitOnTags : public testing::Test {
 protected:
  SuitOnTags() : scene_(reference("wave_hello"), suit_, AtEnd::kThereAndBack) {}

  VirtualRig rig() { return {second_skin_rig(), scene_, OpticalNoise{}, 7}; }

  // What the tags send in some cycles, tag by tag.
  std::vector<Bytes> bytes(const TagLink& link, int cycles, std::uint64_t seed = 3) {
    VirtualRig fresh = rig();
    VirtualTags tags(fresh, tag_sizes(suit_), link, seed);
    std::vector<Bytes> out(tags.tags());
    for (int i = 0; i < cycles; ++i) {
      tags.cycle(i * tags.cycle_time(), [&](std::size_t tag, double, auto packet) {
        out[tag].insert(out[tag].end(), packet.begin(), packet.end());
      });
    }
    return out;
  }

  std::vector<Set> decode(const Bytes& stream, std::size_t detectors, wire::TagCounters* counters,
                          bool gray = false) {
    wire::TagDecoder decoder({detectors, 16, gray});
    std::vector<Set> sets;
    const auto sink = [&](const wire::TagSet& set) { sets.push_back(set.values); };
    decoder.feed(stream, 0, sink);
    decoder.finish(sink);
    if (counters != nullptr) *counters = decoder.counters();
    return sets;
  }

  Suit suit_ = shipped_suit("second_skin");
  SuitScene scene_;
};

TEST_F(SuitOnTags, SendEachTagsDetectorsInTheOrderOfItsInputs) {
  EXPECT_EQ(tag_sizes(suit_), (std::vector<std::size_t>{18, 8}));
  const std::vector<Bytes> streams = bytes({}, 20);
  VirtualRig same = rig();
  const auto first = decode(streams[0], 18, nullptr), second = decode(streams[1], 8, nullptr);
  ASSERT_EQ(first.size(), 20U);
  ASSERT_EQ(second.size(), 20U);
  for (int i = 0; i < 20; ++i) {
    Set values(26 * 16);
    same.cycle(i * 0.016, values);
    Set joined = first[static_cast<std::size_t>(i)];
    const Set& rest = second[static_cast<std::size_t>(i)];
    joined.insert(joined.end(), rest.begin(), rest.end());
    ASSERT_EQ(joined, values);
  }
}

TEST_F(SuitOnTags, InGrayCodeTellTheSameButForOneValue) {
  TagLink link;
  link.gray = true;
  const auto gray = decode(bytes(link, 50)[0], 18, nullptr, true);
  const auto binary = decode(bytes({}, 50)[0], 18, nullptr);
  ASSERT_EQ(gray.size(), binary.size());
  for (std::size_t i = 0; i < gray.size(); ++i) {
    for (std::size_t k = 0; k < gray[i].size(); ++k) {
      ASSERT_EQ(gray[i][k], binary[i][k] == 170 ? 171 : binary[i][k]);
    }
  }
}

TEST_F(SuitOnTags, ArriveLateAndInOrder) {
  TagLink link;
  link.latency = 0.015;
  link.jitter = 0.015;
  link.packet = 100;
  VirtualRig fresh = rig();
  VirtualTags tags(fresh, tag_sizes(suit_), link, 1);
  std::vector<double> last(2, 0.0);
  double earliest = 1.0, latest = 0.0;
  for (int i = 0; i < 500; ++i) {
    const double begin = i * tags.cycle_time();
    tags.cycle(begin, [&](std::size_t tag, double time, auto packet) {
      EXPECT_LE(packet.size(), 100U);
      EXPECT_GE(time, last[tag]);
      last[tag] = time;
      earliest = std::min(earliest, time - begin);
      latest = std::max(latest, time - begin);
    });
  }
  // The set is complete when the cycle ends.
  EXPECT_NEAR(earliest, 0.016 + 0.015, 0.001);
  EXPECT_NEAR(latest, 0.016 + 0.015 + 0.015, 0.001);
}

TEST_F(SuitOnTags, TearTheAskedShareOfTheSets) {
  TagLink link;
  link.torn_share = 0.1;
  wire::TagCounters counters;
  const auto torn = decode(bytes(link, 3000)[0], 18, &counters);
  // A torn start byte tears the set before too.
  EXPECT_NEAR(static_cast<double>(torn.size()) / 3000.0, 0.9, 0.03);
  EXPECT_GT(counters.torn, 200U);
  const auto whole = decode(bytes({}, 3000)[0], 18, nullptr);
  auto at = whole.begin();
  for (const Set& set : torn) {
    at = std::find(at, whole.end(), set);
    ASSERT_NE(at, whole.end());  // each is one that was sent
  }
}

TEST_F(SuitOnTags, LoseTheAskedShareOfTheirBytes) {
  TagLink link;
  link.byte_loss = 0.01;
  const double share = static_cast<double>(bytes(link, 500)[0].size()) / (500.0 * 289.0);
  EXPECT_NEAR(share, 0.99, 0.002);
}

TEST_F(SuitOnTags, AreTheSameForTheSameSeed) {
  TagLink link;
  link.torn_share = 0.2;
  EXPECT_EQ(bytes(link, 50, 1), bytes(link, 50, 1));
  EXPECT_NE(bytes(link, 50, 1), bytes(link, 50, 2));
}

TEST_F(SuitOnTags, SendNothingWhileNoDetectorIsInStep) {
  VirtualRig fresh = rig();
  VirtualTags tags(fresh, tag_sizes(suit_), {}, 1);
  int packets = 0;
  const auto count = [&](std::size_t, double, auto) { ++packets; };
  tags.cycle(0.0, count);
  EXPECT_EQ(packets, 2);
  for (VirtualProjector& projector : fresh.projectors()) projector.dark = true;
  tags.cycle(0.016, count);
  EXPECT_EQ(packets, 2);
}

TEST_F(SuitOnTags, RefuseTagsThatAreNotTheScenes) {
  VirtualRig fresh = rig();
  EXPECT_THROW(VirtualTags(fresh, {18, 7}, {}, 1), std::invalid_argument);
  EXPECT_THROW(VirtualTags(fresh, {26}, {}, 1), std::invalid_argument);
  EXPECT_THROW(VirtualTags(fresh, {18, 8, 0}, {}, 1), std::invalid_argument);
  TagLink link;
  link.torn_share = 1.5;
  EXPECT_THROW(VirtualTags(fresh, {18, 8}, link, 1), std::invalid_argument);
}

TEST_F(SuitOnTags, GoIntoFilesOneATag) {
  VirtualRig fresh = rig();
  VirtualTags tags(fresh, tag_sizes(suit_), {}, 3);
  const std::filesystem::path folder = testing::TempDir();
  const std::vector<std::filesystem::path> files{folder / "virtual_tags_0.bin",
                                                 folder / "virtual_tags_1.bin"};
  write_tag_files(tags, 30, files);
  const std::vector<Bytes> expected = bytes({}, 30);
  for (std::size_t tag = 0; tag < 2; ++tag) {
    std::ifstream in(files[tag], std::ios::binary);
    const Bytes read((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
    EXPECT_EQ(read, expected[tag]);
    std::filesystem::remove(files[tag]);
  }
  EXPECT_THROW(write_tag_files(tags, 1, std::span(files).first(1)), std::invalid_argument);
  const std::vector<std::filesystem::path> nowhere{"/nowhere/a", "/nowhere/b"};
  EXPECT_THROW(write_tag_files(tags, 1, nowhere), std::system_error);
}

}  // namespace
}  // namespace secondskin::sim
