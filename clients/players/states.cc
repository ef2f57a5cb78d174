#include "clients/players/states.h"

#include <algorithm>
#include <array>
#include <map>
#include <stdexcept>

#include "bus/raw.h"
#include "bus/topics.h"
#include "clients/players/topic_file.h"

namespace secondskin::players {
namespace {

namespace msg = bus::msg;

constexpr std::array kStates{bus::kTopicOf<msg::SkeletonDefinition>,
                             bus::kTopicOf<msg::ReferenceMotionList>,
                             bus::kTopicOf<msg::SessionState>, bus::kTopicOf<msg::EmergencyStop>,
                             bus::kTopicOf<msg::RepetitionScore>};

}  // namespace

void write_states(const std::filesystem::path& recording, const std::filesystem::path& to,
                  const Progress& progress, std::stop_token stop) {
  recording::McapReader reader(recording);
  // By size only: a message that comes once a second must not have a block of its own.
  recording::McapWriter out(to, {.chunk_seconds = 3600.0});
  const auto topics = topics_of(reader);
  std::map<std::uint16_t, std::uint16_t> copies;
  for (const auto& channel : reader.channels()) {
    const auto topic = topics.find(channel.id);
    if (topic == topics.end() ||
        std::find(kStates.begin(), kStates.end(), topic->second) == kStates.end()) {
      continue;
    }
    copies[channel.id] =
        out.add_channel(channel.topic, channel.schema_name, channel.schema_encoding,
                        channel.schema_text, channel.message_encoding);
  }
  std::uint64_t done = 0;
  const auto total = static_cast<double>(std::max<std::uint64_t>(reader.messages(), 1));
  reader.for_each([&](const recording::McapMessage& raw) {
    if (++done % 5000 == 0 && progress) progress(static_cast<double>(done) / total);
    const auto copy = copies.find(raw.channel);
    if (copy != copies.end()) {
      out.write(copy->second, raw.sequence, raw.log_time_ns, raw.publish_time_ns, raw.data);
    }
    return !stop.stop_requested();
  });
  if (stop.stop_requested()) throw std::runtime_error("ended before it was done");
  out.close();
}

Learners learners_in(const std::filesystem::path& file, std::stop_token stop) {
  recording::McapReader reader(file);
  const auto topics = topics_of(reader);
  Learners learners;
  bool any = false;
  msg::SessionState state;
  reader.for_each([&](const recording::McapMessage& raw) {
    const auto topic = topics.find(raw.channel);
    if (topic != topics.end() && topic->second == bus::kTopicOf<msg::SessionState> &&
        bus::decode(raw.data, state)) {
      any = true;
      if (state.learner().size() > 0) learners.ids.insert(state.learner().to_string());
    }
    return !stop.stop_requested();
  });
  if (stop.stop_requested()) throw std::runtime_error("ended before it was done");
  learners.sure = any || reader.damage().empty();
  return learners;
}

}  // namespace secondskin::players
