#include "clients/dashboard/foxglove.h"

#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

// The protocol's texts and bytes, against examples of its specification
// (github.com/foxglove/ws-protocol, docs/spec.md).
namespace secondskin::dashboard::foxglove {
namespace {

using nlohmann::json;
using testing::HasSubstr;

TEST(FoxgloveProtocol, ServerInfoOffersClientPublishing) {
  const auto info = json::parse(server_info("a \"name\"", "17"));
  EXPECT_EQ(info["op"], "serverInfo");
  EXPECT_EQ(info["name"], "a \"name\"");
  EXPECT_EQ(info["capabilities"], json::array({"clientPublish"}));
  EXPECT_EQ(info["supportedEncodings"], json::array({"json", "cdr"}));
  EXPECT_EQ(info["sessionId"], "17");
}

TEST(FoxgloveProtocol, AdvertisesEveryFieldOfAChannel) {
  const std::vector<Channel> channels{
      {1, "/tf", "json", "foxglove.FrameTransforms", "{}", "jsonschema"}};
  EXPECT_EQ(json::parse(advertise(channels)),
            json::parse(R"({"op": "advertise", "channels": [{"id": 1, "topic": "/tf",
              "encoding": "json", "schemaName": "foxglove.FrameTransforms", "schema": "{}",
              "schemaEncoding": "jsonschema"}]})"));
  const std::vector<std::uint32_t> ids{1, 2};
  EXPECT_EQ(json::parse(unadvertise(ids)),
            json::parse(R"({"op": "unadvertise", "channelIds": [1, 2]})"));
}

TEST(FoxgloveProtocol, StatusSaysHowBadItIs) {
  EXPECT_EQ(json::parse(status(Level::kError, "no")),
            json::parse(R"({"op": "status", "level": 2, "message": "no"})"));
  // Bytes that are no text do not end the connection.
  EXPECT_NO_THROW(static_cast<void>(status(Level::kInfo, "\xff")));
}

// "opcode 0x01, subscription id uint32, timestamp uint64 nanoseconds", little-endian.
TEST(FoxgloveProtocol, FramesAMessageLittleEndian) {
  const auto head = message_head(0x01020304, 0x1122334455667788);
  EXPECT_THAT(head,
              testing::ElementsAre(1, 4, 3, 2, 1, 0x88, 0x77, 0x66, 0x55, 0x44, 0x33, 0x22, 0x11));
}

TEST(FoxgloveProtocol, ReadsWhatAClientAsks) {
  const auto subscribe = parse_text(
      R"({"op": "subscribe", "subscriptions": [{"id": 0, "channelId": 3}, {"id": 1, "channelId": 5}]})");
  ASSERT_TRUE(subscribe);
  const auto& asked = std::get<Subscribe>(*subscribe).subscriptions;
  ASSERT_EQ(asked.size(), 2u);
  EXPECT_EQ(asked[1].id, 1u);
  EXPECT_EQ(asked[1].channel, 5u);

  const auto unsubscribe = parse_text(R"({"op": "unsubscribe", "subscriptionIds": [0, 1]})");
  ASSERT_TRUE(unsubscribe);
  EXPECT_THAT(std::get<Unsubscribe>(*unsubscribe).subscriptions, testing::ElementsAre(0, 1));

  const auto advertised = parse_text(
      R"({"op": "advertise", "channels": [{"id": 7, "topic": "foo", "encoding": "json", "schemaName": "x"}]})");
  ASSERT_TRUE(advertised);
  EXPECT_EQ(std::get<ClientAdvertise>(*advertised).channels.at(0).topic, "foo");

  const auto gone = parse_text(R"({"op": "unadvertise", "channelIds": [7]})");
  ASSERT_TRUE(gone);
  EXPECT_THAT(std::get<ClientUnadvertise>(*gone).channels, testing::ElementsAre(7));
}

TEST(FoxgloveProtocol, RefusesWithTheFieldThatIsWrong) {
  const auto trouble = [](const char* text) {
    const auto parsed = parse_text(text);
    return parsed ? std::string("taken") : parsed.error();
  };
  EXPECT_THAT(trouble("{"), HasSubstr("expected JSON"));
  EXPECT_THAT(trouble("[]"), HasSubstr("'op'"));
  EXPECT_THAT(trouble("3"), HasSubstr("'op'"));
  EXPECT_THAT(trouble(R"({"op": "getParameters"})"), HasSubstr("'getParameters'"));
  EXPECT_THAT(trouble(R"({"op": "subscribe"})"), HasSubstr("'subscriptions'"));
  EXPECT_THAT(trouble(R"({"op": "subscribe", "subscriptions": [3]})"), HasSubstr("'id'"));
  EXPECT_THAT(trouble(R"({"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]})"),
              HasSubstr("'id'"));
  EXPECT_THAT(trouble(R"({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1e3}]})"),
              HasSubstr("'channelId'"));
  EXPECT_THAT(trouble(R"({"op": "unsubscribe", "subscriptionIds": [4294967296]})"),
              HasSubstr("'subscriptionIds'"));
  EXPECT_THAT(trouble(R"({"op": "advertise", "channels": [{"id": 1, "topic": 2}]})"),
              HasSubstr("'topic'"));
}

TEST(FoxgloveProtocol, ReadsAClientsMessage) {
  const std::vector<std::uint8_t> bytes{1, 4, 3, 2, 1, 'h', 'i'};
  const auto message = parse_binary(bytes);
  ASSERT_TRUE(message);
  EXPECT_EQ(message->channel, 0x01020304u);
  EXPECT_THAT(message->payload, testing::ElementsAre('h', 'i'));
  EXPECT_THAT(parse_binary({}).error(), HasSubstr("opcode"));
  EXPECT_THAT(parse_binary(std::vector<std::uint8_t>{2, 0, 0, 0, 0}).error(),
              HasSubstr("opcode 2"));
  EXPECT_THAT(parse_binary(std::vector<std::uint8_t>{1, 0, 0, 0}).error(), HasSubstr("4 bytes"));
}

}  // namespace
}  // namespace secondskin::dashboard::foxglove
