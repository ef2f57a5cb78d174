#include "wire/osc.h"

#include <gtest/gtest.h>

namespace secondskin::wire {
namespace {

Datagram bytes(std::initializer_list<int> values) {
  Datagram out;
  for (const int value : values) out.push_back(static_cast<std::uint8_t>(value));
  return out;
}

// The two examples of the Open Sound Control 1.0 specification, "OSC Messages: Examples".
TEST(Osc, WritesTheSpecificationsExamples) {
  EXPECT_EQ(OscMessage("/oscillator/4/frequency").add(440.0F).encode(),
            bytes({0x2f, 0x6f, 0x73, 0x63, 0x69, 0x6c, 0x6c, 0x61, 0x74, 0x6f, 0x72,
                   0x2f, 0x34, 0x2f, 0x66, 0x72, 0x65, 0x71, 0x75, 0x65, 0x6e, 0x63,
                   0x79, 0x00, 0x2c, 0x66, 0x00, 0x00, 0x43, 0xdc, 0x00, 0x00}));
  EXPECT_EQ(
      OscMessage("/foo").add(1000).add(-1).add("hello").add(1.234F).add(5.678F).encode(),
      bytes({0x2f, 0x66, 0x6f, 0x6f, 0x00, 0x00, 0x00, 0x00, 0x2c, 0x69, 0x69, 0x73, 0x66, 0x66,
             0x00, 0x00, 0x00, 0x00, 0x03, 0xe8, 0xff, 0xff, 0xff, 0xff, 0x68, 0x65, 0x6c, 0x6c,
             0x6f, 0x00, 0x00, 0x00, 0x3f, 0x9d, 0xf3, 0xb6, 0x40, 0xb5, 0xb2, 0x2d}));
}

TEST(Osc, BundlesAreDueAtOnceAndSayEachMessagesLength) {
  const OscMessage message("/a");
  EXPECT_EQ(
      osc_bundles({{message}}, 100),
      std::vector<Datagram>{bytes({'#', 'b', 'u', 'n', 'd', 'l', 'e', 0,   0, 0, 0,   0, 0, 0,
                                   0,   1,   0,   0,   0,   8,   '/', 'a', 0, 0, ',', 0, 0, 0})});
}

TEST(Osc, NoBundleIsLongerThanAsked) {
  std::vector<OscMessage> messages;
  std::size_t total = 0;
  for (int i = 0; i < 20; ++i) {
    messages.emplace_back("/VMC/Ext/Bone/Pos").add("RightUpperArm").add(1.0F);
    total += messages.back().encode().size() + 4;
  }
  const auto bundles = osc_bundles(messages, 200);
  std::size_t seen = 0;
  for (const Datagram& bundle : bundles) {
    EXPECT_LE(bundle.size(), 200u);
    EXPECT_GT(bundle.size(), 16u);
    seen += bundle.size() - 16;
  }
  EXPECT_EQ(seen, total);
  EXPECT_EQ(osc_bundles(messages, 1).size(), messages.size());
}

}  // namespace
}  // namespace secondskin::wire
