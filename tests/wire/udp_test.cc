#include "wire/udp.h"

#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <stdexcept>
#include <system_error>
#include <thread>
#include <vector>

namespace secondskin::wire {
namespace {

using namespace std::chrono_literals;

TEST(Udp, CarriesDatagramsWhole) {
  UdpReceiver receiver({"127.0.0.1", 0});
  ASSERT_NE(receiver.place().port, 0);
  UdpSender sender(receiver.place());
  std::vector<std::uint8_t> sent(1472);
  for (std::size_t i = 0; i < sent.size(); ++i) sent[i] = static_cast<std::uint8_t>(i * 7);
  EXPECT_TRUE(sender.send(sent));
  std::vector<std::uint8_t> got(2000);
  const auto arrival = receiver.receive(got, 2s);
  ASSERT_TRUE(arrival);
  got.resize(arrival->length);
  EXPECT_EQ(got, sent);
  EXPECT_FALSE(receiver.receive(got, 1ms));
}

TEST(Udp, TellsWhenADatagramCameNotWhenItWasAskedFor) {
  UdpReceiver receiver({"127.0.0.1", 0});
  UdpSender sender(receiver.place());
  std::array<std::uint8_t, 4> datagram{};
  // Linux begins to stamp a little after it is asked to, so the first may bear the later time.
  bool stamped_on_arrival = false;
  for (int i = 0; i < 50 && !stamped_on_arrival; ++i) {
    ASSERT_TRUE(sender.send(datagram));
    const auto sent_ns =
        std::chrono::nanoseconds(std::chrono::system_clock::now().time_since_epoch());
    std::this_thread::sleep_for(50ms);
    const auto arrival = receiver.receive(datagram, 2s);
    ASSERT_TRUE(arrival);
    stamped_on_arrival = arrival->stamp_ns < (sent_ns + 40ms).count();
  }
  EXPECT_TRUE(stamped_on_arrival);
}

TEST(Udp, SendsOnWhereNobodyListens) {
  UdpPlace place;
  {
    const UdpReceiver gone({"127.0.0.1", 0});
    place = gone.place();
  }
  UdpSender sender(place);
  const std::vector<std::uint8_t> datagram{1, 2, 3};
  std::size_t refused = 0;
  for (int i = 0; i < 20; ++i) refused += sender.send(datagram) ? 0 : 1;
  EXPECT_GT(refused, 0u);
  // Who comes back hears the very next one, and no refusal is left over.
  UdpReceiver back(place);
  (void)sender.send(datagram);
  std::vector<std::uint8_t> got(10);
  EXPECT_TRUE(back.receive(got, 2s));
  EXPECT_TRUE(sender.send(datagram));
}

TEST(Udp, ReadsPlacesAndSaysWhatItExpected) {
  EXPECT_EQ(UdpPlace::parse("9763").text(), "127.0.0.1:9763");
  EXPECT_EQ(UdpPlace::parse("127.0.0.2:1").text(), "127.0.0.2:1");
  for (const char* bad :
       {"", ":", "0", "65536", "12x", "-1", "localhost:1", "127.0.0.1:", "1.2.3:4"}) {
    EXPECT_THROW((void)UdpPlace::parse(bad), std::invalid_argument) << bad;
  }
}

TEST(Udp, RefusesAPlaceThatIsTaken) {
  const UdpReceiver first({"127.0.0.1", 0});
  EXPECT_THROW(UdpReceiver second(first.place()), std::system_error);
}

}  // namespace
}  // namespace secondskin::wire
