#include "clients/players/topic_file.h"

#include <fmt/format.h>

#include "motion/whole_file.h"

namespace secondskin::players {

std::map<std::uint16_t, std::size_t> topics_of(const recording::McapReader& reader) {
  std::map<std::uint16_t, std::size_t> topics;
  for (const auto& channel : reader.channels()) {
    for (std::size_t t = 0; t < bus::kTopics.size(); ++t) {
      if (channel.topic.ends_with(fmt::format("/{}", bus::kTopics[t].name))) topics[channel.id] = t;
    }
  }
  return topics;
}

std::string subject_of(const recording::McapReader& reader) {
  constexpr std::string_view kProduct = "/secondskin/";
  for (const auto& channel : reader.channels()) {
    const auto end = channel.topic.rfind('/');
    if (channel.topic.starts_with(kProduct) && end > kProduct.size()) {
      return channel.topic.substr(kProduct.size(), end - kProduct.size());
    }
  }
  return "recording";
}

TopicFile::TopicFile(const std::filesystem::path& file, const std::filesystem::path& idl,
                     std::string subject)
    : writer_(file), idl_(read_whole_file(idl)), subject_(std::move(subject)) {}

void TopicFile::write_bytes(std::size_t topic, std::string_view name, std::int64_t time_ns,
                            std::span<const std::uint8_t> bytes) {
  const auto& info = bus::kTopics[topic];
  if (name.empty()) name = info.name;
  auto channel = channels_.find(name);
  if (channel == channels_.end()) {
    const auto id = writer_.add_channel(fmt::format("/secondskin/{}/{}", subject_, name),
                                        bus::idl_type_name(info.type_name), "omgidl", idl_);
    channel = channels_.emplace(std::string(name), Channel{id, 0}).first;
  }
  writer_.write(channel->second.id, ++channel->second.count, time_ns, time_ns, bytes);
}

}  // namespace secondskin::players
