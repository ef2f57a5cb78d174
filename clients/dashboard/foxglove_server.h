#pragma once

#include <atomic>
#include <deque>
#include <map>
#include <string>
#include <vector>

#include "clients/dashboard/foxglove.h"
#include "clients/dashboard/web_server.h"

/// Channels and their subscribers over the Foxglove WebSocket protocol.
namespace secondskin::dashboard {

/// How a channel's messages are kept for those who come later, and for the slow.
enum class Keep : std::uint8_t {
  kStream,  ///< a slow client misses some; a new one gets the newest
  kEach,    ///< a client gets each in its order; a new one the newest of each key
};

struct ServedChannel {
  foxglove::Channel channel;
  Keep keep = Keep::kStream;
};

/// Takes what a client published. @returns why not, for the client; empty when it was taken. On the
/// sockets' thread.
using ClientPublish = std::function<std::string(const foxglove::ClientChannel& channel,
                                                std::span<const std::uint8_t> payload)>;

class FoxgloveServer final : public WebSocketService {
 public:
  /// @param channels  their ids are their places, from 1
  /// @param publishable  topics that clients may publish
  /// @throws std::runtime_error as WebServer.
  FoxgloveServer(std::vector<ServedChannel> channels, std::vector<std::string> publishable,
                 ClientPublish take, WebServerOptions options, std::vector<HttpHandler> handlers);
  ~FoxgloveServer() override;

  void start() { web_.start(); }
  void stop() { web_.stop(); }
  std::uint16_t port() const noexcept { return web_.port(); }
  WebServerCounts counts() const noexcept { return web_.counts(); }

  /// Whether anybody subscribes to a channel, by its place. Any thread.
  bool wanted(std::size_t channel) const noexcept;

  /// Hands a message over to all subscribers. Any thread; never waits for one.
  /// @param key  of Keep::kEach: the newest of each is kept for new subscribers
  void publish(std::size_t channel, std::int64_t time_ns, std::vector<std::uint8_t> bytes,
               std::string key = {});
  /// Keeps nothing any more whose key is less. Any thread.
  void forget_before(std::size_t channel, std::string key);

 private:
  struct Kept {
    std::string key;
    std::int64_t time_ns;
    Bytes bytes;
  };
  struct Served {
    ServedChannel info;
    std::deque<Kept> kept;  ///< oldest first
    std::map<ClientId, std::uint32_t> subscribers;
    std::atomic<std::size_t> count{0};
  };
  struct Client {
    std::map<std::uint32_t, std::size_t> subscriptions;         ///< its id to the channel's place
    std::map<std::uint32_t, foxglove::ClientChannel> channels;  ///< that it publishes
  };

  void opened(ClientId client) override;
  void closed(ClientId client) override;
  void text(ClientId client, std::string_view message) override;
  void binary(ClientId client, std::span<const std::uint8_t> message) override;

  void take(ClientId client, const foxglove::Subscribe& subscribe);
  void take(ClientId client, const foxglove::Unsubscribe& unsubscribe);
  void take(ClientId client, const foxglove::ClientAdvertise& advertise);
  void take(ClientId client, const foxglove::ClientUnadvertise& unadvertise);

  void send_text(ClientId client, const std::string& text);
  void refuse(ClientId client, const std::string& why);
  void send(ClientId client, std::uint32_t subscription, const Served& channel, const Kept& kept);
  void keep(Served& channel, Kept kept);

  // Of the sockets' thread, but for the counts.
  std::vector<std::unique_ptr<Served>> channels_;
  std::vector<std::string> publishable_;
  ClientPublish take_;
  std::string session_id_;
  std::string advertisement_;
  std::map<ClientId, Client> clients_;
  WebServer web_;
};

}  // namespace secondskin::dashboard
