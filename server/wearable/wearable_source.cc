#include "server/wearable/wearable_source.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "motion/kinematics.h"

namespace secondskin::server {
namespace {

constexpr std::int64_t kSilenceAfter = 250'000'000;   // of measurements without a pose [ns]
constexpr std::int64_t kMagneticEvery = 100'000'000;  // [ns]
constexpr std::int64_t kHoldEvery = 50'000'000;       // [ns]
constexpr double kHoldPlace = 0.1, kHoldTurn = 0.2;   // [m], [rad]
constexpr double kFieldStrays = 0.15;  // of its strength: iron is near, the direction means nothing

// A board's readings under the board that it truly is.
void reorder(const Measurement& from, const std::vector<std::size_t>& channel, Measurement& to) {
  to.kind = from.kind;
  to.stamp_ns = from.stamp_ns;
  to.source = from.source;
  to.boards.resize(from.boards.size());
  to.distances.resize(from.distances.size());
  for (std::size_t b = 0; b < channel.size(); ++b) {
    if (channel[b] < from.boards.size()) to.boards[b] = from.boards[channel[b]];
    if (channel[b] < from.distances.size()) to.distances[b] = from.distances[channel[b]];
  }
}

}  // namespace

WearableSource::WearableSource(std::unique_ptr<MeasurementStream> stream, Garment garment,
                               WearableOptions options)
    : stream_(std::move(stream)),
      garment_(std::move(garment)),
      options_(std::move(options)),
      skeleton_(body_of(options_.start)),
      starter_(garment_, options_.start) {
  every_ = static_cast<std::uint64_t>(
      std::max(1.0, std::ceil(garment_.inertial_rate_hz / options_.most_poses)));
  if (stream_->live()) {
    options_.start.refine_bones = false;
    starter_ = Starter(garment_, options_.start);
    return;
  }
  Next next{};
  while (!started() && look_for_start(next)) {
  }
  if (started()) return;
  try {
    (void)starter_.finish();  // says why not
  } catch (const std::runtime_error& error) {
    const std::string trouble = stream_->trouble();
    throw std::runtime_error(error.what() + (trouble.empty() ? trouble : "; " + trouble));
  }
}

double WearableSource::rate_hz() const {
  return garment_.inertial_rate_hz / static_cast<double>(every_);
}

// Reads one measurement. @returns false at silence and at the end, which `next` then tells.
bool WearableSource::look_for_start(Next& next) {
  next = stream_->next(measurement_);
  if (next == Next::kEnd && !started()) {
    try {
      start_ = starter_.finish();
    } catch (const std::runtime_error&) {
      return false;
    }
    begin();
    return true;
  }
  if (next != Next::kPose) return false;
  const auto before = starter_.stage();
  const auto stage = starter_.add(measurement_);
  if (before != Starter::Stage::kWaitingForRest) waiting_.push_back(measurement_);
  if (stage == Starter::Stage::kDone) {
    start_ = starter_.finish();
    begin();
  }
  return true;
}

void WearableSource::begin() {
  skeleton_ = start_->skeleton;
  filter_.emplace(skeleton_, garment_, start_->X_BS, options_.filter);
  filter_->start(start_->pose, start_->stamp_ns, start_->biases);
  contacts_.emplace(skeleton_, garment_, options_.contacts);
  contacts_->stand_here(*filter_);
  first_ns_ = start_->stamp_ns;
  root_board_.reset();
  for (const SensorBoard& board : garment_.boards) {
    const std::size_t segment = index(board.segment);
    if (!root_board_ || segment < *root_board_) root_board_ = segment;
  }
  if (root_board_ == index(Joint::kPelvis)) root_board_.reset();
  field_W_.assign(garment_.boards.size(), std::nullopt);
  if (options_.magnetic > 0.0) {
    std::vector<Eigen::Isometry3d> X_WB(kJointCount);
    forward_kinematics(skeleton_, start_->pose.p_WR, start_->pose.q_PB, X_WB);
    for (std::size_t b = 0; b < garment_.boards.size(); ++b) {
      if (!start_->fields_S[b]) continue;
      field_W_[b] = X_WB[index(garment_.boards[b].segment)].linear() * start_->X_BS[b].linear() *
                    *start_->fields_S[b];
    }
  }
}

void WearableSource::process(const Measurement& raw) {
  reorder(raw, start_->channel, reordered_);
  filter_->process(reordered_);
  use_magnetometers(reordered_);
  hold_root(reordered_.stamp_ns);
  if (options_.use_contacts) contacts_->update(reordered_, *filter_);
}

// Without a board on the pelvis nothing tells where it is and how the trunk below the next board is
// bent: it is held loosely under that board, and, where no foot tells, in its place.
void WearableSource::hold_root(std::int64_t stamp_ns) {
  if (!root_board_ || stamp_ns - held_ns_ < kHoldEvery) return;
  held_ns_ = stamp_ns;
  Eigen::Quaterniond q_WB = Eigen::Quaterniond::Identity();
  for (std::optional<std::size_t> i = *root_board_; i; i = skeleton_[*i].parent) {
    q_WB = filter_->pose().q_PB[*i] * q_WB;
  }
  Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
  X_WR.linear() = q_WB.toRotationMatrix();
  X_WR.translation() = contacts_->feet() > 0 ? filter_->pose().p_WR : start_->pose.p_WR;
  (void)filter_->observe_root(stamp_ns, X_WR, kHoldPlace, kHoldTurn);
}

// Each board's own field at rest is its reference: among walls fields differ from place to place.
void WearableSource::use_magnetometers(const Measurement& measurement) {
  if (measurement.kind != MeasurementKind::kInertial ||
      measurement.stamp_ns - magnetic_ns_ < kMagneticEvery) {
    return;
  }
  magnetic_ns_ = measurement.stamp_ns;
  for (std::size_t b = 0; b < field_W_.size(); ++b) {
    const BoardReading& reading = measurement.boards[b];
    if (!field_W_[b] || !reading.magnetic_valid) continue;
    const double strength = reading.magnetic.norm() / field_W_[b]->norm();
    if (std::abs(strength - 1.0) > kFieldStrays) continue;
    (void)filter_->observe_direction(measurement.stamp_ns, b, reading.magnetic, *field_W_[b],
                                     options_.magnetic);
  }
}

bool WearableSource::gives_pose(const Measurement& measurement, StampedPose& pose) {
  if (measurement.kind != MeasurementKind::kInertial) return false;
  // Counted by time, so that samples that never came leave a gap in the numbers.
  const double samples =
      1e-9 * static_cast<double>(measurement.stamp_ns - *first_ns_) * garment_.inertial_rate_hz;
  const auto frame = static_cast<std::uint64_t>(std::max(0.0, std::round(samples))) / every_ + 1;
  if (frame <= frame_) return false;
  frame_ = frame;
  pose.frame = frame;
  pose.stamp_ns = measurement.stamp_ns;
  pose.pose = filter_->pose();
  return true;
}

// First what was felt while the start was looked for.
bool WearableSource::next_measurement(Next& next) {
  next = Next::kPose;
  newest_ = &measurement_;
  if (waited_ < waiting_.size()) {
    newest_ = &waiting_[waited_++];
    return true;
  }
  if (!waiting_.empty()) {
    waiting_ = {};
    waited_ = 0;
  }
  next = stream_->next(measurement_);
  return next == Next::kPose;
}

void WearableSource::smooth_all() {
  is_smoothed_ = true;
  given_ = 0;
  smoothed_.clear();
  Smoother smoother(options_.filter);
  std::vector<std::pair<std::size_t, std::uint64_t>> shown;  // of the smoother's samples; frame
  StampedPose pose;
  Next next{};
  while (next_measurement(next)) {
    process(*newest_);
    if (newest_->kind != MeasurementKind::kInertial) continue;
    smoother.add(*filter_);
    if (gives_pose(*newest_, pose)) shown.emplace_back(smoother.size() - 1, pose.frame);
  }
  const auto all = smoother.smooth();
  for (const auto& [at, frame] : shown) {
    smoothed_.push_back(all[at]);
    smoothed_.back().frame = frame;
  }
}

Next WearableSource::next(StampedPose& pose) {
  const auto tell = [&](Next what) {
    if (observer_) observer_(*this, what);
    return what;
  };
  std::optional<std::int64_t> began_ns;
  while (true) {
    if (!started()) {
      Next next{};
      if (!look_for_start(next)) return tell(next);
    } else {
      if (options_.smooth && !live()) {
        if (!is_smoothed_) smooth_all();
        if (given_ == smoothed_.size()) return tell(Next::kEnd);
        pose = smoothed_[given_++];
        frame_ = pose.frame;
        return tell(Next::kPose);
      }
      Next next{};
      if (!next_measurement(next)) return tell(next);
      process(*newest_);
      if (gives_pose(*newest_, pose)) return tell(Next::kPose);
    }
    if (!live()) continue;
    if (!began_ns) began_ns = measurement_.stamp_ns;
    if (measurement_.stamp_ns - *began_ns > kSilenceAfter) return tell(Next::kSilence);
  }
}

bool WearableSource::rewind() {
  if (live() || !stream_->rewind()) return false;
  // The start is known: the recording is played again from there.
  Measurement m;
  waiting_.clear();
  waited_ = 0;
  begin();
  frame_ = 0;
  is_smoothed_ = false;
  magnetic_ns_ = held_ns_ = 0;
  while (stream_->next(m) == Next::kPose) {
    if (m.stamp_ns > start_->stamp_ns) {
      waiting_.push_back(m);
      break;
    }
  }
  return true;
}

}  // namespace secondskin::server
