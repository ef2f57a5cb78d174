#include "clients/dashboard/access.h"

#include <gtest/gtest.h>

namespace secondskin::dashboard {
namespace {

const AccessRules kOpen;
const AccessRules kGuarded{.token = "secret", .allowed_origins = {"https://app.example"}};

TEST(Access, IsFreeOnThisMachineByItsNamesOnly) {
  for (const char* host : {"", "localhost:8765", "127.0.0.1:8765", "[::1]:8765", "LOCALHOST"}) {
    EXPECT_EQ(judge(kOpen, {.host = host}), Access::kGranted) << host;
  }
  // A foreign name that was given the address 127.0.0.1: its pages would read what they like.
  for (const char* host : {"evil.example:8765", "localhost.evil.example", "127.evil.example:8765",
                           "127.0.0.1.evil.example", "192.168.1.5:8765"}) {
    EXPECT_EQ(judge(kOpen, {.host = host}), Access::kForeignHost) << host;
  }
}

TEST(Access, KeepsForeignPagesFromChanging) {
  const auto with = [](const char* origin) {
    return Credentials{.changes = true, .host = "localhost:8765", .origin = origin};
  };
  EXPECT_EQ(judge(kOpen, with("")), Access::kGranted);  // a program, no page
  EXPECT_EQ(judge(kOpen, with("http://localhost:8765")), Access::kGranted);
  for (const char* origin : {"http://localhost:3000", "https://evil.example", "null", "file://",
                             "http://localhost:8765.evil.example"}) {
    EXPECT_EQ(judge(kOpen, with(origin)), Access::kForeignOrigin) << origin;
  }
  const AccessRules allowing{.token = {}, .allowed_origins = {"https://app.example"}};
  EXPECT_EQ(judge(allowing, with("https://app.example")), Access::kGranted);
  EXPECT_EQ(judge(allowing, with("https://app.example.evil")), Access::kForeignOrigin);
  // Reading is guarded by the browser itself, which shows the answer to no foreign page.
  EXPECT_EQ(judge(kOpen, {.host = "localhost", .origin = "https://evil.example"}),
            Access::kGranted);
}

TEST(Access, TakesTheTokenFromAnyOfItsPlaces) {
  EXPECT_EQ(judge(kGuarded, {.host = "box:8765"}), Access::kNoToken);
  EXPECT_EQ(judge(kGuarded, {.authorization = "Bearer secret"}), Access::kGranted);
  EXPECT_EQ(judge(kGuarded, {.authorization = "bearer secret"}), Access::kGranted);
  EXPECT_EQ(judge(kGuarded, {.query_token = "secret"}), Access::kGranted);
  EXPECT_EQ(judge(kGuarded, {.cookie = "a=b; secondskin_token=secret"}), Access::kGranted);
  for (const char* wrong : {"s", "secre", "secrets", "secretsecret", "Secret", ""}) {
    EXPECT_EQ(judge(kGuarded, {.query_token = wrong}), Access::kNoToken) << wrong;
  }
  EXPECT_EQ(judge(kGuarded, {.cookie = "xsecondskin_token=secret"}), Access::kNoToken);
  EXPECT_EQ(judge(kGuarded, {.authorization = "Basic secret"}), Access::kNoToken);
  // A foreign page does not pass with the cookie that the browser adds.
  EXPECT_EQ(judge(kGuarded, {.changes = true,
                             .host = "box:8765",
                             .origin = "https://evil.example",
                             .cookie = "secondskin_token=secret"}),
            Access::kForeignOrigin);
}

TEST(Access, KnowsWhichAddressesStayOnThisMachine) {
  EXPECT_TRUE(is_loopback("127.0.0.1"));
  EXPECT_TRUE(is_loopback("::1"));
  EXPECT_FALSE(is_loopback("0.0.0.0"));
  EXPECT_FALSE(is_loopback("192.168.1.5"));
  EXPECT_THROW(is_loopback("localhost"), std::runtime_error);
}

}  // namespace
}  // namespace secondskin::dashboard
