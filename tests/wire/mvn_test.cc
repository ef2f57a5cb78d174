#include "wire/mvn.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace secondskin::wire {
namespace {

Datagram bytes(std::initializer_list<int> values) {
  Datagram out;
  for (const int value : values) out.push_back(static_cast<std::uint8_t>(value));
  return out;
}

// Written by hand from the tables of sections 2.4.1 and 2.5.3 of the protocol (MV0305P.N).
Datagram golden_pose() {
  return bytes({0x4d, 0x58, 0x54, 0x50, 0x30, 0x32,  // "MXTP02"
                0x00, 0x00, 0x01, 0x02,              // sample 258
                0x80, 0x01,                          // the only datagram, 1 item
                0x00, 0x00, 0x03, 0xe8,              // 1000 ms
                0x05, 0x17, 0x00, 0x00,              // avatar 5, 23 segments, no props, no fingers
                0x00, 0x00, 0x00, 0x20,              // reserved, 32 bytes follow
                0x00, 0x00, 0x00, 0x0f,              // segment 15, LeftHand
                0x3f, 0x80, 0x00, 0x00,              // x = 1
                0xbf, 0x00, 0x00, 0x00,              // y = -0.5
                0x3f, 0x60, 0x00, 0x00,              // z = 0.875
                0x3f, 0x00, 0x00, 0x00,              // w = 0.5
                0xbf, 0x00, 0x00, 0x00,              // i = -0.5
                0x3f, 0x00, 0x00, 0x00,              // j = 0.5
                0x3f, 0x00, 0x00, 0x00});            // k = 0.5
}

MvnHeader golden_header() {
  MvnHeader header;
  header.sample = 258;
  header.time_ms = 1000;
  header.avatar = 5;
  return header;
}

MvnFault decode(const Datagram& datagram, MvnHeader* header = nullptr,
                std::vector<MvnSegment>* segments = nullptr) {
  MvnFault fault{};
  std::vector<MvnSegment> scratch;
  const auto decoded = decode_mvn_header(datagram, fault);
  if (!decoded) return fault;
  if (header != nullptr) *header = *decoded;
  return decode_mvn_pose(datagram, *decoded, segments != nullptr ? *segments : scratch);
}

TEST(Mvn, WritesAPoseAsTheProtocolsTablesSay) {
  EXPECT_EQ(
      encode_mvn_pose(golden_header(), {{{15, {1, -0.5F, 0.875F}, {0.5F, -0.5F, 0.5F, 0.5F}}}}),
      golden_pose());
}

TEST(Mvn, ReadsAPoseAsTheProtocolsTablesSay) {
  MvnHeader header;
  std::vector<MvnSegment> segments;
  ASSERT_EQ(decode(golden_pose(), &header, &segments), MvnFault::kNone);
  EXPECT_EQ(header.type_text(), "02");
  EXPECT_EQ(header.sample, 258u);
  EXPECT_EQ(header.datagram, 0x80);
  EXPECT_EQ(header.time_ms, 1000u);
  EXPECT_EQ(header.avatar, 5);
  EXPECT_EQ(header.body_segments, 23);
  EXPECT_EQ(header.payload, 32);
  ASSERT_EQ(segments.size(), 1u);
  EXPECT_EQ(segments[0].id, 15u);
  EXPECT_EQ(segments[0].position, (std::array<float, 3>{1, -0.5F, 0.875F}));
  EXPECT_EQ(segments[0].orientation, (std::array<float, 4>{0.5F, -0.5F, 0.5F, 0.5F}));
}

TEST(Mvn, ReadsHeadersFromBeforeMvn2019) {
  Datagram old = golden_pose();
  for (std::size_t i = 17; i < 24; ++i) old[i] = 0;  // "7 bytes reserved for future use"
  EXPECT_EQ(decode(old), MvnFault::kNone);
}

// Sections 2.5.12, 2.6.1 and 2.6.2.
TEST(Mvn, WritesNameAndTPoseAsTheProtocolSays) {
  MvnHeader header;
  const Datagram name = encode_mvn_meta_data(header, "Anna");
  EXPECT_EQ(Datagram(name.begin(), name.begin() + 6), bytes({'M', 'X', 'T', 'P', '1', '2'}));
  EXPECT_EQ(Datagram(name.begin() + 22, name.end()),
            bytes({0, 14, 0, 0, 0, 10, 'n', 'a', 'm', 'e', ':', 'A', 'n', 'n', 'a', '\n'}));
  const Datagram scale = encode_mvn_scale(header, {{{"L5", {0, 0, 1}}}});
  EXPECT_EQ(Datagram(scale.begin(), scale.begin() + 6), bytes({'M', 'X', 'T', 'P', '1', '3'}));
  EXPECT_EQ(Datagram(scale.begin() + 22, scale.end()),
            bytes({0, 26, 0, 0, 0, 1, 0,    0,    0, 2, 'L', '5', 0, 0,
                   0, 0,  0, 0, 0, 0, 0x3f, 0x80, 0, 0, 0,   0,   0, 0}));
}

TEST(Mvn, NamesWhatIsWrong) {
  Datagram bad = golden_pose();
  bad[0] = 'X';
  EXPECT_EQ(decode(bad), MvnFault::kForeign);
  bad = golden_pose();
  bad[4] = 'A';
  EXPECT_EQ(decode(bad), MvnFault::kForeign);
  bad = golden_pose();
  bad[11] = 2;  // items
  EXPECT_EQ(decode(bad), MvnFault::kWrongLength);
  bad = golden_pose();
  bad[23] = 0x21;  // payload
  EXPECT_EQ(decode(bad), MvnFault::kWrongLength);
  bad = golden_pose();
  bad[27] = 0;  // segment id
  EXPECT_EQ(decode(bad), MvnFault::kBadNumber);
  MvnSegment segment{1, {0, 0, std::numeric_limits<float>::quiet_NaN()}, {1, 0, 0, 0}};
  EXPECT_EQ(decode(encode_mvn_pose({}, {{segment}})), MvnFault::kBadNumber);
  segment = {1, {0, 0, 0}, {1.1F, 0, 0, 0}};
  EXPECT_EQ(decode(encode_mvn_pose({}, {{segment}})), MvnFault::kBadNumber);
  segment = {1, {0, 0, 0}, {0, 0, std::numeric_limits<float>::infinity(), 0}};
  EXPECT_EQ(decode(encode_mvn_pose({}, {{segment}})), MvnFault::kBadNumber);
}

TEST(Mvn, RefusesADatagramCutAnywhere) {
  const std::vector<MvnSegment> segments(23, MvnSegment{1, {0, 0, 0}, {1, 0, 0, 0}});
  const Datagram whole = encode_mvn_pose({}, segments);
  ASSERT_EQ(whole.size(), 760u);  // what MVN sends for a body without props and fingers
  ASSERT_EQ(decode(whole), MvnFault::kNone);
  for (std::size_t length = 0; length < whole.size(); ++length) {
    // A copy of exactly this length, so that the address sanitizer sees a byte read too many.
    const Datagram cut(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(length));
    EXPECT_NE(decode(cut), MvnFault::kNone) << length;
  }
}

TEST(Mvn, SurvivesAnyBytes) {
  std::mt19937 random(2019);
  std::uniform_int_distribution<int> byte(0, 255), length(0, 200), where(0, 55), changes(1, 4);
  std::size_t refused = 0;
  constexpr int kTries = 20'000;
  for (int i = 0; i < kTries; ++i) {
    Datagram noise(static_cast<std::size_t>(length(random)));
    for (auto& b : noise) b = static_cast<std::uint8_t>(byte(random));
    if (noise.size() >= 6 && i % 2 == 0) std::copy_n(golden_pose().begin(), 6, noise.begin());
    if (decode(noise) != MvnFault::kNone) ++refused;

    Datagram bent = golden_pose();
    for (int k = changes(random); k > 0; --k) {
      bent[static_cast<std::size_t>(where(random))] = static_cast<std::uint8_t>(byte(random));
    }
    std::vector<MvnSegment> segments;
    if (decode(bent, nullptr, &segments) != MvnFault::kNone) continue;
    for (const MvnSegment& segment : segments) {
      float square = 0;
      for (const float value : segment.orientation) square += value * value;
      EXPECT_NEAR(square, 1.0F, 0.03F);
      for (const float value : segment.position) EXPECT_TRUE(std::isfinite(value));
    }
  }
  EXPECT_GT(refused, kTries * 99 / 100);
}

}  // namespace
}  // namespace secondskin::wire
