#include <fmt/core.h>
#include <gtest/gtest.h>

#include <regex>

#include "tests/dashboard/web_client.h"
#include "tests/session/session.h"

// The large button of any page: how long from its WebSocket message until the board drives nothing,
// by the board's own record. Real processes throughout.

namespace secondskin::session {
namespace {

constexpr std::int64_t kLongest_ns = 100'000'000;  // what is promised of the button
constexpr int kTimes = 5;

TEST(StopButton, TurnsTheBoardOffWithinATenthOfASecond) {
  const Session session;
  Process board = session.board();
  ASSERT_TRUE(eventually([&] { return board.says("port "); }, 10s));
  Process tactors = session.tactors();
  Process coach = session.coach();
  Process capture = session.capture();
  Process bridge = session.start("dashboard", session.on_bus({"dashboard", "--port", "0"}));
  ASSERT_TRUE(eventually([&] { return bridge.says("http://"); }, 10s)) << bridge.output();
  std::smatch found;
  const std::string said = bridge.output();
  ASSERT_TRUE(std::regex_search(said, found, std::regex("http://127.0.0.1:([0-9]+)/")));
  const auto port = static_cast<std::uint16_t>(std::stoi(found[1]));

  dashboard::test::WebClient watching(port), page(port);
  const std::string stop = "/secondskin/test_" + std::to_string(::getpid()) + "/stop";
  page.read_channels();
  std::int64_t worst = 0;
  for (int i = 0; i < kTimes; ++i) {
    ASSERT_TRUE(eventually([&] { return session.tactors_are_on(); }, 60s));
    const std::int64_t pressed = monotonic_ns();
    page.publish(1, stop, "json", R"({"active": true, "reason": "button"})");
    std::this_thread::sleep_for(400ms);  // long enough for anything late to show
    std::int64_t last_on = pressed;
    const auto rows = read_waveform(session.waveform());
    for (std::size_t r = 0; r < rows.size(); ++r) {
      if (rows[r].slots_on == 0 && rows[r].strongest == 0.0) continue;
      last_on = std::max(last_on, r + 1 < rows.size() ? rows[r + 1].monotonic_ns : monotonic_ns());
    }
    EXPECT_FALSE(session.tactors_are_on());
    worst = std::max(worst, last_on - pressed);
    page.publish(1, stop, "json", R"({"active": false, "reason": "button"})");
  }
  fmt::print("the board was off at most {:.1f} ms after the button\n",
             static_cast<double>(worst) * 1e-6);
  EXPECT_LT(worst, kLongest_ns);
}

}  // namespace
}  // namespace secondskin::session
