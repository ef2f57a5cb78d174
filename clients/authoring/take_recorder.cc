#include "clients/authoring/take_recorder.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <mutex>
#include <optional>
#include <stdexcept>

#include "bus/pose_messages.h"
#include "bus/reader.h"
#include "bus/wait_set.h"
#include "bus/writer.h"
#include "clients/authoring/cut.h"
#include "motion/anatomy.h"

namespace secondskin::authoring {

namespace msg = bus::msg;

namespace {

constexpr double kAlive = 0.5;     // without a pose for longer, the source is not there [s]
constexpr double kVanished = 1.5;  // a recording does not wait longer [s]
constexpr double kGap = 0.25;      // is told of [s]
constexpr std::int64_t kAskAgain = 500'000'000;  // a session that does not pause [ns]
constexpr auto kTick = std::chrono::milliseconds(50);

double seconds(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }
std::int64_t nanoseconds(double s) { return static_cast<std::int64_t>(s * 1e9); }

}  // namespace

struct TakeRecorder::State {
  State(bus::Participant& participant, std::function<void(Recorded)> keep_)
      : keep(std::move(keep_)),
        skeletons(participant),
        poses(participant, bus::Want::kEvery),
        sessions(participant),
        orders(participant) {
    for (bus::ReaderBase* reader :
         {static_cast<bus::ReaderBase*>(&skeletons), static_cast<bus::ReaderBase*>(&poses),
          static_cast<bus::ReaderBase*>(&sessions)}) {
      news.attach(*reader);
    }
  }

  // ---- on run()'s thread, with the mutex

  void listen() {
    msg::SkeletonDefinition definition;
    if (skeletons.take_newest(definition) > 0) meet(definition);
    if (sessions.take_newest(session) > 0 && session.phase() != msg::SESSION_PAUSED &&
        session.phase() != msg::SESSION_RUNNING) {
      paused = false;
    }
    while (poses.take(message)) {
      newest_ns = bus::now_ns();
      if (phase == RecorderPhase::kRecording) take();
    }
  }

  void meet(const msg::SkeletonDefinition& definition) {
    const bool another = body && definition.skeleton_id() != body_id;
    try {
      Skeleton skeleton = bus::to_skeleton(definition);
      if (!is_canonical(skeleton)) return;
      if (another && phase == RecorderPhase::kRecording) {
        finish("the measured body changed; the recording ended there");
      }
      body = std::move(skeleton);
      body_id = definition.skeleton_id();
      source = definition.source().to_string();
      rate_hz = definition.rate_hz();
    } catch (const std::exception& error) {
      spdlog::warn("take recorder: {}", error.what());
    }
  }

  void take() {
    const std::uint64_t frame = message.header().frame();
    const bool of_body = message.skeleton_id() == body_id;
    if (!of_body) return finish("the measured body changed; the recording ended there");
    if (message.header().stamp_ns() < start_ns) return;  // was measured before the start
    if (last_frame && frame > *last_frame + 1) lost += frame - *last_frame - 1;
    last_frame = frame;
    if (!bus::from_message(message, pose) || pose.pose.q_PB.size() != kJointCount) {
      ++lost;
      return;
    }
    ++came;
    if (!recorded.empty()) {
      const double gap = seconds(pose.stamp_ns - recorded.back().stamp_ns);
      if (gap > kGap) {
        faults.push_back(fmt::format("nothing was measured for {:.1f} s, {:.1f} s after the start",
                                     gap, seconds(recorded.back().stamp_ns - start_ns)));
      }
    }
    recorded.push_back(pose);
  }

  void go_on() {
    const std::int64_t now = bus::now_ns();
    if (phase != RecorderPhase::kIdle) hold_session(now);
    if (phase == RecorderPhase::kCountdown && now >= start_ns) begin();
    if (phase != RecorderPhase::kRecording) return;
    if (now >= start_ns + nanoseconds(most)) return finish("");
    if (seconds(now - std::max(newest_ns, start_ns)) > kVanished) {
      finish("the source went silent; the recording ended there");
    }
  }

  void begin() {
    phase = RecorderPhase::kRecording;
    recorded.clear();
    faults.clear();
    lost = came = 0;
    last_frame.reset();
  }

  // Nothing may vibrate on the expert: whoever starts a session meanwhile is paused too.
  void hold_session(std::int64_t now) {
    if (session.phase() != msg::SESSION_RUNNING || now - asked_ns < kAskAgain) return;
    asked_ns = now;
    paused = true;
    msg::SessionCommand order;
    order.publish_ns(now);
    order.action(msg::SESSION_PAUSE);
    orders.write(order);
  }

  void finish(const std::string& fault) {
    phase = RecorderPhase::kIdle;
    if (!fault.empty()) faults.push_back(fault);
    if (lost > 0) {
      faults.push_back(fmt::format("{} of {} frames were lost", lost, lost + came));
    }
    const bool enough = recorded.size() > 1 && seconds(recorded.back().stamp_ns -
                                                       recorded.front().stamp_ns) >= kShortestTake;
    try {
      if (!enough) {
        throw std::runtime_error(fmt::format("less than {} s were recorded{}{}", kShortestTake,
                                             fault.empty() ? "" : ": ", fault));
      }
      keep({evenly(*body, rate_hz > 0.0 ? rate_hz : 60.0, recorded), source, start_ns, faults});
      ++kept;
    } catch (const std::exception& error) {
      trouble = fmt::format("The take was not kept: {}.", error.what());
      spdlog::warn("{}", trouble);
    }
    recorded.clear();
  }

  mutable std::mutex mutex;
  std::function<void(Recorded)> keep;
  bus::Reader<msg::SkeletonDefinition> skeletons;
  bus::Reader<msg::SkeletonPose> poses;
  bus::Reader<msg::SessionState> sessions;
  bus::Writer<msg::SessionCommand> orders;
  bus::WaitSet news;

  RecorderPhase phase = RecorderPhase::kIdle;
  std::int64_t start_ns = 0, newest_ns = 0, asked_ns = 0;
  double most = 0.0;
  std::optional<Skeleton> body;
  std::uint32_t body_id = 0;
  std::string source;
  double rate_hz = 0.0;
  msg::SessionState session;
  bool paused = false;
  std::vector<StampedPose> recorded;
  std::vector<std::string> faults;
  std::optional<std::uint64_t> last_frame;
  std::uint64_t lost = 0, came = 0, kept = 0;
  std::string trouble;
  msg::SkeletonPose message;
  StampedPose pose;
};

TakeRecorder::TakeRecorder(bus::Participant& participant, std::function<void(Recorded)> keep)
    : state_(std::make_unique<State>(participant, std::move(keep))) {}

TakeRecorder::~TakeRecorder() = default;

void TakeRecorder::record(double countdown, double most_seconds) {
  // Written so that NaN is refused.
  if (!(countdown >= 0.0 && countdown <= kLongestCountdown)) {
    throw std::invalid_argument(
        fmt::format("countdown: expected 0 to {} seconds", kLongestCountdown));
  }
  if (!(most_seconds >= 1.0 && most_seconds <= kLongestRecording)) {
    throw std::invalid_argument(
        fmt::format("most_seconds: expected 1 to {} seconds", kLongestRecording));
  }
  auto& s = *state_;
  const std::lock_guard lock(s.mutex);
  if (s.phase != RecorderPhase::kIdle) {
    throw std::runtime_error("a recording is under way: stop it first");
  }
  const std::int64_t now = bus::now_ns();
  if (!s.body || seconds(now - s.newest_ns) > kAlive) {
    throw std::runtime_error("nobody is measured: expected a capture server that sends poses");
  }
  s.phase = RecorderPhase::kCountdown;
  s.start_ns = now + nanoseconds(countdown);
  s.most = most_seconds;
  s.trouble.clear();
  s.paused = s.session.phase() == msg::SESSION_PAUSED;
  s.news.wake();
}

void TakeRecorder::stop() {
  auto& s = *state_;
  const std::lock_guard lock(s.mutex);
  if (s.phase == RecorderPhase::kCountdown) s.phase = RecorderPhase::kIdle;
  if (s.phase != RecorderPhase::kRecording) return;
  s.listen();
  if (s.phase == RecorderPhase::kRecording) s.finish("");
}

RecorderState TakeRecorder::state() const {
  const auto& s = *state_;
  const std::lock_guard lock(s.mutex);
  const std::int64_t now = bus::now_ns();
  RecorderState state;
  state.phase = s.phase;
  const double since = seconds(now - s.start_ns);
  if (s.phase == RecorderPhase::kCountdown) state.remaining = std::max(0.0, -since);
  if (s.phase == RecorderPhase::kRecording) state.elapsed = std::max(0.0, since);
  state.most = s.most;
  state.alive = s.body && seconds(now - s.newest_ns) < kAlive;
  state.source = s.source;
  state.rate_hz = s.rate_hz;
  state.lost = s.lost;
  state.paused = s.paused;
  state.trouble = s.trouble;
  state.recorded = s.kept;
  return state;
}

void TakeRecorder::run(std::stop_token stop) {
  auto& s = *state_;
  const std::stop_callback wake(stop, [&s] { s.news.wake(); });
  while (!stop.stop_requested()) {
    {
      const std::lock_guard lock(s.mutex);
      s.listen();
      s.go_on();
    }
    s.news.wait(kTick);
  }
}

}  // namespace secondskin::authoring
