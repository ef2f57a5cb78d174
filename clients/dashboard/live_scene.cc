#include "clients/dashboard/live_scene.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>

#include "bus/participant.h"
#include "bus/pose_messages.h"
#include "bus/topics.h"
#include "clients/dashboard/ghost.h"
#include "clients/dashboard/scene.h"
#include "coach/coach_messages.h"
#include "coach/plan/session_plan.h"

namespace secondskin::dashboard {

namespace msg = bus::msg;
using Clock = std::chrono::steady_clock;

namespace {

template <class Message>
constexpr std::size_t kPlace = bus::kTopicOf<Message>;

constexpr std::array kUsed{kPlace<msg::SkeletonDefinition>, kPlace<msg::SkeletonPose>,
                           kPlace<msg::SessionState>, kPlace<msg::Alignment>,
                           kPlace<msg::TactorCommand>};

std::vector<std::uint8_t> bytes_of(const std::string& text) { return {text.begin(), text.end()}; }

}  // namespace

struct LiveScene::State {
  explicit State(LiveSceneOptions given) : options(std::move(given)) {}

  struct Newest {
    std::vector<std::uint8_t> bytes;
    std::int64_t source_ns = 0;
    bool fresh = false;
  };
  using Inbox = std::array<Newest, bus::kTopics.size()>;

  bool anybody_looks() const {
    return options.wanted(Drawn::kExpert) || options.wanted(Drawn::kTransforms) ||
           options.wanted(Drawn::kScene);
  }

  /// Moves what is fresh out of the inbox, so that nobody waits while it is used.
  void collect() {
    const std::lock_guard lock(mutex);
    for (const std::size_t topic : kUsed) {
      taken[topic].fresh = inbox[topic].fresh;
      if (!inbox[topic].fresh) continue;
      std::swap(taken[topic].bytes, inbox[topic].bytes);
      taken[topic].source_ns = inbox[topic].source_ns;
      inbox[topic].fresh = false;
    }
    news = false;
  }

  template <class Message>
  bool read(Message& message) const {
    const Newest& newest = taken[kPlace<Message>];
    return newest.fresh && bus::decode(newest.bytes, message);
  }

  void update() {
    if (read(skeleton_message)) take_skeleton();
    if (read(session)) take_session();
    if (read(pose_message) && skeleton && pose_message.skeleton_id() == skeleton_id) {
      has_pose = bus::from_message(pose_message, learner) && learner.pose.is_valid() &&
                 learner.pose.q_PB.size() == kJointCount;
    }
    if (read(command)) {
      wire::BoardState state;
      std::copy(command.intensities().begin(), command.intensities().end(), state.begin());
      level = levels(state);
    }
    if (read(alignment) && has_pose) follow();
    draw();
  }

  void take_skeleton() {
    ghost.reset();
    has_pose = has_ghost = false;
    skeleton.reset();
    skeleton_id = skeleton_message.skeleton_id();
    try {
      Skeleton body = bus::to_skeleton(skeleton_message);
      if (is_canonical(body)) skeleton = std::move(body);
    } catch (const std::exception& error) {
      spdlog::warn("dashboard: {}", error.what());
    }
  }

  void take_session() {
    coach::TactileSetup ignored;
    if (!coach::from_message(session, map, ignored)) map.tactors.clear();
    const std::string name = session.reference().to_string();
    if (name == reference_name && session.reference_fingerprint() == fingerprint &&
        session.block_tempo() == tempo) {
      return;
    }
    const bool another = name != reference_name || session.reference_fingerprint() != fingerprint;
    reference_name = name;
    fingerprint = session.reference_fingerprint();
    tempo = session.block_tempo();
    ghost.reset();
    has_ghost = false;
    try {
      if (another) reference = options.reference(name);
      at_tempo = reference ? coach::at_tempo(reference, tempo > 0.0 ? tempo : 1.0) : nullptr;
    } catch (const std::exception& error) {
      spdlog::warn("dashboard: no ghost: {}", error.what());
      reference = at_tempo = nullptr;
    }
  }

  void follow() {
    if (!ghost && at_tempo && skeleton) ghost.emplace(at_tempo, *skeleton);
    if (!ghost) return;
    ghost->place(alignment.reference_time(), learner.pose, expert.pose);
    has_ghost = true;
    if (!options.wanted(Drawn::kExpert)) return;
    expert.frame = alignment.header().frame();
    expert.stamp_ns = alignment.header().stamp_ns();
    bus::to_message(expert, skeleton_id, expert_message);
    expert_message.header().publish_ns(bus::now_ns());
    options.publish(Drawn::kExpert, taken[kPlace<msg::Alignment>].source_ns,
                    bus::encode(expert_message));
  }

  void draw() {
    if (!has_pose || !taken[kPlace<msg::SkeletonPose>].fresh) return;
    const auto now = Clock::now();
    if (now < next_scene) return;
    constexpr std::chrono::duration<double> kPeriod(1.0 / kSceneRate);
    next_scene = std::max(next_scene + std::chrono::duration_cast<Clock::duration>(kPeriod), now);
    const std::int64_t time_ns = taken[kPlace<msg::SkeletonPose>].source_ns;
    const Figure body{*skeleton, learner.pose};
    const Figure shadow{*skeleton, expert.pose};
    const Figure* with = has_ghost ? &shadow : nullptr;
    if (options.wanted(Drawn::kTransforms)) {
      options.publish(Drawn::kTransforms, time_ns,
                      bytes_of(frame_transforms(time_ns, options.subject, body, with)));
    }
    if (options.wanted(Drawn::kScene)) {
      options.publish(Drawn::kScene, time_ns,
                      bytes_of(scene_update(time_ns, body, with, map.tactors, level)));
    }
  }

  LiveSceneOptions options;
  std::mutex mutex;  // guards inbox and news
  std::condition_variable_any arrived;
  Inbox inbox;
  bool news = false;

  // Of the computing thread.
  Inbox taken;
  msg::SkeletonDefinition skeleton_message;
  msg::SkeletonPose pose_message, expert_message;
  msg::SessionState session;
  msg::Alignment alignment;
  msg::TactorCommand command;
  std::optional<Skeleton> skeleton;
  std::uint32_t skeleton_id = 0;
  StampedPose learner, expert;
  bool has_pose = false, has_ghost = false;
  coach::BodyMap map;
  std::array<double, wire::kTactorCount> level{};
  std::string reference_name;
  std::uint64_t fingerprint = 0;
  double tempo = 1.0;
  std::shared_ptr<const coach::Reference> reference, at_tempo;
  std::optional<Ghost> ghost;
  Clock::time_point next_scene{};
};

LiveScene::LiveScene(LiveSceneOptions options)
    : state_(std::make_unique<State>(std::move(options))) {}

LiveScene::~LiveScene() = default;

void LiveScene::take(std::size_t topic, std::int64_t source_ns,
                     std::span<const std::uint8_t> bytes) {
  auto& s = *state_;
  if (std::find(kUsed.begin(), kUsed.end(), topic) == kUsed.end()) return;
  {
    const std::lock_guard lock(s.mutex);
    auto& newest = s.inbox[topic];
    newest.bytes.assign(bytes.begin(), bytes.end());
    newest.source_ns = source_ns;
    newest.fresh = true;
    // Each alignment follows its pose; without a coach the pose alone must do.
    const bool due = topic == kPlace<msg::Alignment> || topic == kPlace<msg::SkeletonPose>;
    s.news = s.news || due;
    if (!due) return;
  }
  if (s.anybody_looks()) s.arrived.notify_one();
}

void LiveScene::run(std::stop_token stop) {
  auto& s = *state_;
  while (!stop.stop_requested()) {
    {
      std::unique_lock lock(s.mutex);
      s.arrived.wait(lock, stop, [&s] { return s.news && s.anybody_looks(); });
    }
    if (stop.stop_requested()) return;
    s.collect();
    s.update();
  }
}

}  // namespace secondskin::dashboard
