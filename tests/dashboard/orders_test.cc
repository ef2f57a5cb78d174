#include "clients/dashboard/orders.h"

#include <gmock/gmock.h>

#include "bus/topics.h"

namespace secondskin::dashboard {
namespace {

namespace msg = bus::msg;
using testing::HasSubstr;

std::span<const std::uint8_t> bytes(std::string_view text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

std::string refusal(std::string_view json) {
  const auto order = session_command("json", bytes(json));
  return order ? "taken" : order.error();
}

TEST(Orders, ReadASessionCommandFromJson) {
  const auto order = session_command(
      "json", bytes(R"({"action": "start", "reference": "squat", "tolerance_scale": 1.5,
                       "max_cues": 3, "plan": "fading", "learner": "p1"})"));
  ASSERT_TRUE(order) << order.error();
  EXPECT_EQ(order->action(), msg::SESSION_START);
  EXPECT_EQ(order->reference().to_string(), "squat");
  EXPECT_EQ(order->tolerance_scale(), 1.5);
  EXPECT_EQ(order->max_cues(), 3u);
  EXPECT_EQ(order->plan().to_string(), "fading");
  EXPECT_EQ(order->learner().to_string(), "p1");
}

TEST(Orders, KeepWhatIsLeftOut) {
  for (const auto& [word, action] : {std::pair("start", msg::SESSION_START),
                                     {"pause", msg::SESSION_PAUSE},
                                     {"resume", msg::SESSION_RESUME},
                                     {"stop", msg::SESSION_STOP}}) {
    const auto order = session_command("json", bytes(std::string("{\"action\":\"") + word + "\"}"));
    ASSERT_TRUE(order);
    EXPECT_EQ(order->action(), action);
    EXPECT_EQ(order->reference().to_string() + order->plan().to_string(), "");
    EXPECT_EQ(order->tolerance_scale(), 0.0);
    EXPECT_EQ(order->max_cues(), 0u);
  }
}

TEST(Orders, RefuseWithTheFieldThatIsWrong) {
  EXPECT_THAT(refusal("x"), HasSubstr("JSON object"));
  EXPECT_THAT(refusal("[]"), HasSubstr("JSON object"));
  EXPECT_THAT(refusal("{}"), HasSubstr("'action': expected start, pause, resume, stop"));
  EXPECT_THAT(refusal(R"({"action": 1})"), HasSubstr("'action'"));
  EXPECT_THAT(refusal(R"({"action": "start", "speed": 1})"), HasSubstr("'speed'"));
  EXPECT_THAT(refusal(R"({"action": "start", "tolerance_scale": 0.01})"),
              HasSubstr("'tolerance_scale': expected 0 (keep) or 0.1 to 10"));
  EXPECT_THAT(refusal(R"({"action": "start", "tolerance_scale": "1"})"),
              HasSubstr("'tolerance_scale'"));
  EXPECT_THAT(refusal(R"({"action": "start", "max_cues": 17})"), HasSubstr("'max_cues'"));
  EXPECT_THAT(refusal(R"({"action": "start", "max_cues": -1})"), HasSubstr("'max_cues'"));
  EXPECT_THAT(refusal(R"({"action": "start", "max_cues": 1.5})"), HasSubstr("'max_cues'"));
  EXPECT_THAT(refusal(R"({"action": "start", "learner": ")" + std::string(65, 'x') + "\"}"),
              HasSubstr("'learner': expected a text of at most 64"));
}

TEST(Orders, ReadCdrAndRefuseWhatIsNotWhole) {
  msg::SessionCommand sent;
  sent.action(msg::SESSION_PAUSE);
  sent.reference("squat");
  auto encoded = bus::encode(sent);
  const auto order = session_command("cdr", encoded);
  ASSERT_TRUE(order);
  EXPECT_EQ(order->action(), msg::SESSION_PAUSE);
  EXPECT_EQ(order->reference().to_string(), "squat");
  EXPECT_THAT(session_command("cdr", std::span(encoded).first(20)).error(), HasSubstr("whole"));
  sent.max_cues(1000);
  EXPECT_THAT(session_command("cdr", bus::encode(sent)).error(), HasSubstr("'max_cues'"));
}

TEST(Orders, ReadAStop) {
  const auto stop = emergency_stop("json", bytes(R"({"active": true, "reason": "tired"})"));
  ASSERT_TRUE(stop);
  EXPECT_TRUE(stop->active());
  EXPECT_EQ(stop->reason().to_string(), "tired");
  EXPECT_THAT(emergency_stop("json", bytes("{}")).error(), HasSubstr("'active'"));
  EXPECT_THAT(emergency_stop("json", bytes(R"({"active": 1})")).error(), HasSubstr("'active'"));
  EXPECT_TRUE(emergency_stop("cdr", bus::encode(*stop))->active());
}

}  // namespace
}  // namespace secondskin::dashboard
