#include "clients/dashboard/foxglove_server.h"

#include <gmock/gmock.h>
#include <unistd.h>

#include <fstream>
#include <mutex>
#include <thread>

#include "clients/dashboard/worker.h"
#include "tests/bus/test_domain.h"
#include "tests/dashboard/web_client.h"

// The server over real sockets of this machine.
namespace secondskin::dashboard {
namespace {

namespace fs = std::filesystem;
using bus::eventually;
using test::Answer;
using test::get;
using test::request;
using test::WebClient;
using testing::HasSubstr;
using namespace std::chrono_literals;

constexpr std::size_t kStreamChannel = 0, kStateChannel = 1;

std::vector<std::uint8_t> bytes(const std::string& text) { return {text.begin(), text.end()}; }

class ServerTest : public testing::Test {
 protected:
  ServerTest() {
    std::string name = (fs::temp_directory_path() / "secondskin_XXXXXX").string();
    page_ = ::mkdtemp(name.data());
    std::ofstream(page_ / "index.html") << "<html>";
    options_.port = 0;
    options_.page = page_;
    options_.no_page = "no page yet";
  }
  ~ServerTest() override {
    server_.reset();
    fs::remove_all(page_);
  }

  std::uint16_t start() {
    const auto channel = [](const char* topic) {
      return foxglove::Channel{.id = 0,
                               .topic = topic,
                               .encoding = "json",
                               .schema_name = "x",
                               .schema = "{}",
                               .schema_encoding = "jsonschema"};
    };
    const HttpHandler echo = [](const HttpRequest& asked) -> std::optional<HttpResponse> {
      if (asked.path == "/api/throw") throw std::runtime_error("what went wrong");
      if (asked.path != "/api/echo") return std::nullopt;
      return HttpResponse{.status = 200,
                          .content_type = "text/plain",
                          .body = asked.method + asked.body + asked.query.at("q"),
                          .file_name = "echo.txt"};
    };
    server_ = std::make_unique<FoxgloveServer>(
        std::vector<ServedChannel>{{channel("/stream"), Keep::kStream},
                                   {channel("/state"), Keep::kEach}},
        std::vector<std::string>{"/order"},
        [this](const foxglove::ClientChannel& from, std::span<const std::uint8_t> payload) {
          const std::lock_guard lock(mutex_);
          orders_.emplace_back(payload.begin(), payload.end());
          return from.encoding == "cdr" ? std::string("not like this") : std::string();
        },
        options_, std::vector<HttpHandler>{echo});
    server_->start();
    return server_->port();
  }

  std::vector<std::string> orders() {
    const std::lock_guard lock(mutex_);
    return orders_;
  }

  fs::path page_;
  WebServerOptions options_;
  std::unique_ptr<FoxgloveServer> server_;
  std::mutex mutex_;
  std::vector<std::string> orders_;
};

// ---- HTTP

TEST_F(ServerTest, ServesThePageAndSaysWhenItIsKnown) {
  const auto port = start();
  const Answer first = get(port, "/");
  EXPECT_EQ(first.status, 200u);
  EXPECT_EQ(first.body, "<html>");
  const Answer again = get(port, "/", {{"If-None-Match", first.headers.at("ETag")}});
  EXPECT_EQ(again.status, 304u);
  EXPECT_EQ(again.body, "");
  EXPECT_EQ(request(port, test::http::verb::head, "/").body, "");
  EXPECT_EQ(request(port, test::http::verb::post, "/").status, 405u);
  EXPECT_EQ(get(port, "/none").status, 404u);
  EXPECT_EQ(get(port, "/../../etc/passwd").status, 404u);
  EXPECT_EQ(get(port, "/%2e%2e/%2e%2e/etc/passwd").status, 404u);
  EXPECT_EQ(get(port, "/%").status, 400u);
  fs::remove(page_ / "index.html");
  EXPECT_EQ(get(port, "/").body, "no page yet");
}

TEST_F(ServerTest, HandsRequestsToTheHandlers) {
  const auto port = start();
  const Answer echo = request(port, test::http::verb::patch, "/api/echo?q=%20x", {}, "body");
  EXPECT_EQ(echo.status, 200u);
  EXPECT_EQ(echo.body, "PATCHbody x");
  EXPECT_THAT(echo.headers.at("Content-Disposition"), HasSubstr("echo.txt"));
  EXPECT_EQ(get(port, "/api/none").status, 404u);
  const Answer failed = get(port, "/api/throw");
  EXPECT_EQ(failed.status, 500u);
  EXPECT_EQ(nlohmann::json::parse(failed.body)["error"], "what went wrong");
}

TEST_F(ServerTest, LimitsWhatIsSent) {
  options_.largest_body = 1000;
  const auto port = start();
  EXPECT_EQ(
      request(port, test::http::verb::post, "/api/echo?q=", {}, std::string(1001, 'x')).status,
      413u);
  EXPECT_EQ(get(port, "/", {{"X-Long", std::string(20'000, 'x')}}).status, 431u);
  EXPECT_EQ(get(port, "/").status, 200u);
}

TEST_F(ServerTest, RefusesAStrangerBeforeTheBodyIsThere) {
  options_.access.token = "secret";
  const auto port = start();
  boost::asio::io_context io;
  auto socket = test::connected(io, port);
  const std::string header =
      "POST /api/echo HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 900\r\n\r\n";
  boost::asio::write(socket, boost::asio::buffer(header));
  boost::beast::flat_buffer buffer;
  test::http::response<test::http::string_body> answer;
  test::http::read(socket, buffer, answer);
  EXPECT_EQ(answer.result_int(), 401u);
  EXPECT_FALSE(answer.keep_alive());
}

TEST_F(ServerTest, AsksForTheTokenAndKeepsItInACookie) {
  options_.access.token = "secret";
  const auto port = start();
  EXPECT_EQ(get(port, "/").status, 401u);
  EXPECT_EQ(get(port, "/api/echo?q=").status, 401u);
  EXPECT_EQ(get(port, "/?token=wrong").status, 401u);
  const Answer opened = get(port, "/?token=secret");
  EXPECT_EQ(opened.status, 200u);
  const std::string cookie = opened.headers.at("Set-Cookie");
  EXPECT_THAT(cookie, HasSubstr("HttpOnly"));
  EXPECT_THAT(cookie, HasSubstr("SameSite=Strict"));
  EXPECT_EQ(get(port, "/api/echo?q=", {{"Cookie", cookie.substr(0, cookie.find(';'))}}).status,
            200u);
  EXPECT_EQ(get(port, "/", {{"Authorization", "Bearer secret"}}).status, 200u);

  EXPECT_EQ(test::upgrade_status(port), 401u);
  EXPECT_NO_THROW(WebClient(port, {}, "/?token=secret"));
  EXPECT_NO_THROW(WebClient(port, {{"Cookie", "secondskin_token=secret"}}));
}

TEST_F(ServerTest, RefusesForeignPages) {
  const auto port = start();
  EXPECT_EQ(test::upgrade_status(port, {{"Origin", "https://evil.example"}}), 403u);
  EXPECT_EQ(
      request(port, test::http::verb::post, "/api/echo?q=", {{"Origin", "https://evil.example"}})
          .status,
      403u);
  EXPECT_EQ(get(port, "/", {{"Host", "evil.example"}}).status, 403u);
  EXPECT_NO_THROW(WebClient(port, {{"Origin", "http://127.0.0.1"}}));
}

// ---- WebSocket

TEST_F(ServerTest, GreetsWithServerInfoAndChannels) {
  const auto port = start();
  WebClient client(port);
  EXPECT_EQ(client.agreed(), "foxglove.websocket.v1");
  EXPECT_EQ(client.read_op("serverInfo")["capabilities"][0], "clientPublish");
  const auto channels = client.read_channels();
  EXPECT_EQ(channels.at("/stream"), 1u);
  EXPECT_EQ(channels.at("/state"), 2u);
  EXPECT_EQ(WebClient(port, {}, "/any", "other, foxglove.sdk.v1").agreed(), "foxglove.sdk.v1");
  EXPECT_EQ(test::upgrade_status(port, {}, "/", "mqtt"), 400u);
  EXPECT_EQ(test::upgrade_status(port), 101u);
}

TEST_F(ServerTest, ALateSubscriberGetsTheNewestOfEachKeyInOrder) {
  const auto port = start();
  server_->publish(kStreamChannel, 1, bytes("old"));
  server_->publish(kStreamChannel, 2, bytes("new"));
  server_->publish(kStateChannel, 3, bytes("a1"), "a");
  server_->publish(kStateChannel, 4, bytes("b1"), "b");
  server_->publish(kStateChannel, 5, bytes("a2"), "a");
  server_->publish(kStateChannel, 6, bytes("c1"), "c");
  server_->forget_before(kStateChannel, "b");
  WebClient client(port);
  client.read_channels();
  client.subscribe(7, 1);
  EXPECT_EQ(client.read_of(7).payload(), "new");
  client.subscribe(8, 2);
  const auto first = client.read_of(8);
  EXPECT_EQ(first.payload(), "b1");
  EXPECT_EQ(first.time_ns(), 4);
  EXPECT_EQ(client.read_of(8).payload(), "c1");
  EXPECT_TRUE(server_->wanted(kStreamChannel));
  client.write({{"op", "unsubscribe"}, {"subscriptionIds", {7}}});
  EXPECT_TRUE(eventually([&] { return !server_->wanted(kStreamChannel); }));
}

TEST_F(ServerTest, ToldWhatIsWrongAClientStaysConnected) {
  const auto port = start();
  WebClient client(port);
  client.read_channels();
  const auto complaint = [&] {
    const auto status = client.read_op("status");
    EXPECT_EQ(status["level"], 2);
    return status["message"].get<std::string>();
  };
  client.write_text("{");
  EXPECT_THAT(complaint(), HasSubstr("JSON"));
  client.subscribe(1, 3);
  EXPECT_THAT(complaint(), HasSubstr("channelId 3"));
  client.subscribe(1, 1);
  client.subscribe(1, 2);
  EXPECT_THAT(complaint(), HasSubstr("not in use"));
  client.publish(4, "/stream", "json", "x");
  EXPECT_THAT(complaint(), HasSubstr("expected /order"));
  EXPECT_THAT(complaint(), HasSubstr("advertised"));
  client.publish(5, "/order", "cdr", "x");
  EXPECT_THAT(complaint(), HasSubstr("/order: not like this"));
  client.publish(6, "/order", "json", "go");
  EXPECT_TRUE(eventually([&] { return orders().size() == 2 && orders()[1] == "go"; }));
  client.write({{"op", "unadvertise"}, {"channelIds", {6}}});
  client.publish(6, "/order", "json", "again");
  EXPECT_THAT(complaint(), HasSubstr("channel 6"));
}

TEST_F(ServerTest, ClosesWhoSendsTooMuchAtOnce) {
  options_.largest_message = 1000;
  const auto port = start();
  WebClient client(port);
  client.write_text(std::string(1001, ' '));
  EXPECT_THROW(for (;;) client.read(), boost::system::system_error);
  EXPECT_TRUE(eventually([&] { return server_->counts().clients == 0; }));
  EXPECT_EQ(server_->counts().dropped, 0u);  // it was not slow
}

TEST_F(ServerTest, TakesSoManyClientsAndNoMore) {
  options_.most_clients = 2;
  const auto port = start();
  std::optional<WebClient> first(std::in_place, port);
  const WebClient second(port);
  EXPECT_EQ(test::upgrade_status(port), 503u);
  first.reset();
  EXPECT_TRUE(eventually([&] { return server_->counts().clients == 1; }));
  EXPECT_NO_THROW(WebClient(port, {}));
}

// Fifty that only listen, five that take all, one that takes nothing: the five lose nothing of what
// must not be lost, publishing goes on, and the one is closed.
TEST_F(ServerTest, AStuckClientDisturbsNobody) {
  options_.patience = 500ms;
  const auto port = start();
  std::vector<std::unique_ptr<WebClient>> idle;
  for (int i = 0; i < 50; ++i) idle.push_back(std::make_unique<WebClient>(port));
  WebClient stuck(port);
  stuck.read_channels();
  stuck.subscribe(1, 1);
  ASSERT_TRUE(eventually([&] { return server_->wanted(kStreamChannel); }));

  constexpr int kMessages = 300;
  std::vector<std::jthread> active;
  std::atomic<int> ready{0}, whole{0};
  for (int i = 0; i < 5; ++i) {
    active.emplace_back([&] {
      WebClient client(port);
      client.read_channels();
      client.subscribe(1, 1);
      client.subscribe(2, 2);
      client.read_of(2);  // the first, which is kept
      ++ready;
      int next = 1;
      while (next < kMessages && client.read_of(2).payload() == std::to_string(next)) ++next;
      if (next == kMessages) ++whole;
    });
  }
  server_->publish(kStateChannel, 0, bytes("0"));
  ASSERT_TRUE(eventually([&] { return ready == 5; }));
  const std::vector<std::uint8_t> large(60'000);
  for (int i = 1; i < kMessages; ++i) {
    server_->publish(kStreamChannel, i, large);
    server_->publish(kStateChannel, i, bytes(std::to_string(i)));
    std::this_thread::sleep_for(2ms);
  }
  for (auto& thread : active) thread.join();
  EXPECT_EQ(whole, 5);
  EXPECT_TRUE(eventually([&] { return server_->counts().dropped == 1; }));
  EXPECT_TRUE(eventually([&] { return server_->counts().clients == 50; }));
}

TEST_F(ServerTest, AClientThatIsTooFarBehindIsClosed) {
  options_.most_waiting_bytes = 100'000;
  options_.patience = 60s;
  const auto port = start();
  WebClient slow(port);
  slow.read_channels();
  slow.subscribe(1, 2);
  const std::vector<std::uint8_t> large(50'000);
  EXPECT_TRUE(eventually([&] {
    server_->publish(kStateChannel, 1, large);
    return server_->counts().dropped == 1;
  }));
}

TEST_F(ServerTest, ANewServerHasThePortAtOnce) {
  options_.port = start();
  {
    const WebClient client(options_.port);
    EXPECT_THROW(FoxgloveServer({}, {}, {}, options_, {}), std::runtime_error);
    server_.reset();
  }
  EXPECT_EQ(start(), options_.port);
  EXPECT_EQ(get(options_.port, "/").status, 200u);
}

}  // namespace
}  // namespace secondskin::dashboard
