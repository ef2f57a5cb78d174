#include "clients/dashboard/foxglove_server.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>

namespace secondskin::dashboard {
namespace {

// Of one channel; as many as the topic with the deepest history keeps.
constexpr std::size_t kMostKept = 256;
// Of one client: more is a mistake or worse.
constexpr std::size_t kMostClientChannels = 64;

}  // namespace

FoxgloveServer::FoxgloveServer(std::vector<ServedChannel> channels,
                               std::vector<std::string> publishable, ClientPublish take,
                               WebServerOptions options, std::vector<HttpHandler> handlers)
    : publishable_(std::move(publishable)),
      take_(std::move(take)),
      session_id_(std::to_string(std::chrono::system_clock::now().time_since_epoch().count())),
      web_(std::move(options), std::move(handlers), *this) {
  std::vector<foxglove::Channel> advertised;
  for (auto& channel : channels) {
    channel.channel.id = static_cast<std::uint32_t>(channels_.size() + 1);
    advertised.push_back(channel.channel);
    channels_.push_back(std::make_unique<Served>());
    channels_.back()->info = std::move(channel);
  }
  advertisement_ = foxglove::advertise(advertised);
}

FoxgloveServer::~FoxgloveServer() { stop(); }

bool FoxgloveServer::wanted(std::size_t channel) const noexcept {
  return channels_[channel]->count.load(std::memory_order_relaxed) > 0;
}

void FoxgloveServer::publish(std::size_t channel, std::int64_t time_ns,
                             std::vector<std::uint8_t> bytes, std::string key) {
  Kept message{std::move(key), time_ns,
               std::make_shared<const std::vector<std::uint8_t>>(std::move(bytes))};
  web_.post([this, channel, message = std::move(message)] {
    Served& served = *channels_[channel];
    keep(served, message);
    for (const auto& [client, subscription] : served.subscribers) {
      send(client, subscription, served, message);
    }
  });
}

void FoxgloveServer::forget_before(std::size_t channel, std::string key) {
  web_.post([this, channel, key = std::move(key)] {
    std::erase_if(channels_[channel]->kept, [&](const Kept& kept) { return kept.key < key; });
  });
}

void FoxgloveServer::keep(Served& channel, Kept kept) {
  std::erase_if(channel.kept, [&](const Kept& other) { return other.key == kept.key; });
  channel.kept.push_back(std::move(kept));
  if (channel.kept.size() > kMostKept) channel.kept.pop_front();
}

void FoxgloveServer::send(ClientId client, std::uint32_t subscription, const Served& channel,
                          const Kept& kept) {
  Frame frame{.body = kept.bytes,
              .head = foxglove::message_head(subscription, kept.time_ns),
              .text = false,
              .stream = {}};
  if (channel.info.keep == Keep::kStream) frame.stream = channel.info.channel.id;
  web_.send(client, std::move(frame));
}

void FoxgloveServer::send_text(ClientId client, const std::string& text) {
  web_.send(client,
            {.body = std::make_shared<const std::vector<std::uint8_t>>(text.begin(), text.end()),
             .head = {},
             .text = true,
             .stream = {}});
}

void FoxgloveServer::refuse(ClientId client, const std::string& why) {
  send_text(client, foxglove::status(foxglove::Level::kError, why));
}

void FoxgloveServer::opened(ClientId client) {
  clients_[client];
  send_text(client, foxglove::server_info("Second Skin", session_id_));
  send_text(client, advertisement_);
}

void FoxgloveServer::closed(ClientId client) {
  for (const auto& [id, place] : clients_[client].subscriptions) {
    channels_[place]->subscribers.erase(client);
    channels_[place]->count = channels_[place]->subscribers.size();
  }
  clients_.erase(client);
}

void FoxgloveServer::text(ClientId client, std::string_view message) {
  const auto parsed = foxglove::parse_text(message);
  if (!parsed) return refuse(client, parsed.error());
  std::visit([&](const auto& asked) { take(client, asked); }, *parsed);
}

void FoxgloveServer::binary(ClientId client, std::span<const std::uint8_t> message) {
  const auto parsed = foxglove::parse_binary(message);
  if (!parsed) return refuse(client, parsed.error());
  const auto& channels = clients_[client].channels;
  const auto channel = channels.find(parsed->channel);
  if (channel == channels.end()) {
    return refuse(client, fmt::format("message on channel {}: expected one that was advertised",
                                      parsed->channel));
  }
  const std::string trouble = take_(channel->second, parsed->payload);
  if (!trouble.empty()) refuse(client, fmt::format("{}: {}", channel->second.topic, trouble));
}

void FoxgloveServer::take(ClientId client, const foxglove::Subscribe& subscribe) {
  auto& subscriptions = clients_[client].subscriptions;
  for (const auto& asked : subscribe.subscriptions) {
    const std::size_t place = asked.channel - 1;
    if (asked.channel < 1 || asked.channel > channels_.size()) {
      refuse(client, fmt::format("subscribe: channelId {}: expected 1 to {}", asked.channel,
                                 channels_.size()));
      continue;
    }
    Served& channel = *channels_[place];
    if (subscriptions.contains(asked.id) || channel.subscribers.contains(client)) {
      refuse(client, fmt::format("subscribe: id {}, channelId {}: expected an id that is not in "
                                 "use and one subscription a channel",
                                 asked.id, asked.channel));
      continue;
    }
    subscriptions.emplace(asked.id, place);
    channel.subscribers.emplace(client, asked.id);
    channel.count = channel.subscribers.size();
    for (const Kept& kept : channel.kept) send(client, asked.id, channel, kept);
  }
}

void FoxgloveServer::take(ClientId client, const foxglove::Unsubscribe& unsubscribe) {
  auto& subscriptions = clients_[client].subscriptions;
  for (const std::uint32_t id : unsubscribe.subscriptions) {
    const auto found = subscriptions.find(id);
    if (found == subscriptions.end()) {
      refuse(client, fmt::format("unsubscribe: id {}: expected one that is in use", id));
      continue;
    }
    Served& channel = *channels_[found->second];
    channel.subscribers.erase(client);
    channel.count = channel.subscribers.size();
    web_.forget(client, channel.info.channel.id);
    subscriptions.erase(found);
  }
}

void FoxgloveServer::take(ClientId client, const foxglove::ClientAdvertise& advertise) {
  auto& channels = clients_[client].channels;
  for (const auto& channel : advertise.channels) {
    if (std::find(publishable_.begin(), publishable_.end(), channel.topic) == publishable_.end()) {
      refuse(client, fmt::format("advertise: topic '{:.100}': expected {}", channel.topic,
                                 fmt::join(publishable_, " or ")));
    } else if (channel.encoding != "json" && channel.encoding != "cdr") {
      refuse(client, fmt::format("advertise: {}: encoding '{:.40}': expected json or cdr",
                                 channel.topic, channel.encoding));
    } else if (channels.contains(channel.id) || channels.size() >= kMostClientChannels) {
      refuse(client, fmt::format("advertise: id {}: expected one that is not in use, at most {}",
                                 channel.id, kMostClientChannels));
    } else {
      channels.emplace(channel.id, channel);
    }
  }
}

void FoxgloveServer::take(ClientId client, const foxglove::ClientUnadvertise& unadvertise) {
  for (const std::uint32_t id : unadvertise.channels) clients_[client].channels.erase(id);
}

}  // namespace secondskin::dashboard
