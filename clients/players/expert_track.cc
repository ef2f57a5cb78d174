#include "clients/players/expert_track.h"

#include <fmt/format.h>

#include <stdexcept>

#include "bus/pose_messages.h"
#include "clients/players/topic_file.h"
#include "coach/plan/session_plan.h"
#include "motion/anatomy.h"

namespace secondskin::players {

namespace msg = bus::msg;

void ExpertTrack::take(const msg::SkeletonDefinition& body) {
  if (body_ && body_id_ == body.skeleton_id()) return;
  ghost_.reset();
  has_pose_ = false;
  body_.reset();
  body_id_ = body.skeleton_id();
  try {
    Skeleton skeleton = bus::to_skeleton(body);
    if (is_canonical(skeleton)) body_ = std::move(skeleton);
  } catch (const std::exception& error) {
    missing_ = error.what();
  }
}

void ExpertTrack::take(const msg::SessionState& state) {
  const std::string name = state.reference().to_string();
  const double tempo = state.block_tempo() > 0.0 ? state.block_tempo() : 1.0;
  if (name == name_ && tempo == tempo_) return;
  name_ = name;
  tempo_ = tempo;
  ghost_.reset();
  reference_ = nullptr;
  try {
    auto reference = find_(name);
    if (!reference) throw std::runtime_error(fmt::format("reference '{}' is not known", name));
    reference_ = coach::at_tempo(std::move(reference), tempo);
  } catch (const std::exception& error) {
    missing_ = error.what();
  }
}

void ExpertTrack::take(const msg::SkeletonPose& pose) {
  if (!body_ || pose.skeleton_id() != body_id_) return;
  has_pose_ = bus::from_message(pose, learner_) && learner_.pose.is_valid() &&
              learner_.pose.q_PB.size() == kJointCount;
}

const msg::SkeletonPose* ExpertTrack::take(const msg::Alignment& alignment) {
  if (!has_pose_ || !reference_ || !body_) return nullptr;
  if (!ghost_) ghost_.emplace(reference_, *body_);
  ghost_->place(alignment.reference_time(), learner_.pose, expert_.pose);
  expert_.frame = alignment.header().frame();
  expert_.stamp_ns = alignment.header().stamp_ns();
  bus::to_message(expert_, body_id_, message_);
  message_.header().publish_ns(alignment.header().publish_ns());
  return &message_;
}

void write_expert(const std::filesystem::path& recording, const std::filesystem::path& idl,
                  const FindReference& find, const std::filesystem::path& to,
                  const Progress& progress, std::stop_token stop) {
  recording::McapReader reader(recording);
  const auto topics = topics_of(reader);
  TopicFile out(to, idl, subject_of(reader));
  ExpertTrack track(find);
  msg::SkeletonDefinition body;
  msg::SessionState state;
  msg::SkeletonPose pose;
  msg::Alignment alignment;
  std::uint64_t done = 0, ghosts = 0, alignments = 0;
  const auto total = static_cast<double>(std::max<std::uint64_t>(reader.messages(), 1));
  reader.for_each([&](const recording::McapMessage& raw) {
    if (++done % 5000 == 0 && progress) progress(static_cast<double>(done) / total);
    const auto topic = topics.find(raw.channel);
    if (topic == topics.end()) return !stop.stop_requested();
    switch (topic->second) {
      case bus::kTopicOf<msg::SkeletonDefinition>:
        if (bus::decode(raw.data, body)) track.take(body);
        break;
      case bus::kTopicOf<msg::SessionState>:
        if (bus::decode(raw.data, state)) track.take(state);
        break;
      case bus::kTopicOf<msg::SkeletonPose>:
        if (bus::decode(raw.data, pose)) track.take(pose);
        break;
      case bus::kTopicOf<msg::Alignment>:
        if (!bus::decode(raw.data, alignment)) break;
        ++alignments;
        if (const auto* ghost = track.take(alignment)) {
          out.write(raw.log_time_ns, *ghost, "expert");
          ++ghosts;
        }
        break;
      default:
        break;
    }
    return !stop.stop_requested();
  });
  if (alignments == 0) {
    throw std::runtime_error(
        fmt::format("{}: holds no coached session (expected the topics skeleton, session_state, "
                    "alignment)",
                    recording.filename().string()));
  }
  if (ghosts == 0 && !track.missing().empty()) throw std::runtime_error(track.missing());
  if (stop.stop_requested()) throw std::runtime_error("ended before it was done");
  out.close();
}

}  // namespace secondskin::players
