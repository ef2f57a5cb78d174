#include "sim/learner/virtual_learner.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "motion/rotation.h"

namespace secondskin::sim {
namespace {

// Stands between repetitions [s].
constexpr double kReady = 0.6, kHold = 0.4, kReturn = 0.8;
// Less of a movement that is asked for cannot be done: it is left.
constexpr double kLeastPossible = 0.5;
constexpr double kRemembered = 2.0;  // of one's own corrections [s]

Eigen::Vector3d normal_vector(std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  const double x = normal(random), y = normal(random), z = normal(random);
  return {x, y, z};
}

bool can(const AngleRange& range) noexcept { return range.max > range.min; }

// Independent streams from one seed.
std::uint64_t stream(std::uint64_t seed, std::uint64_t which) noexcept {
  return seed * 1'000'003u + which;
}

}  // namespace

VirtualLearner::VirtualLearner(Lesson lesson, const LearnerParameters& parameters,
                               std::uint64_t seed)
    : lesson_(std::move(lesson)),
      p_(parameters),
      body_random_(stream(seed, 1)),
      noise_random_(stream(seed, 2)),
      sight_random_(stream(seed, 3)),
      sense_(lesson_.tactors, parameters, stream(seed, 4)),
      memory_(parameters),
      reference_pose_(kJointCount),
      pose_(kJointCount),
      end_pose_(kJointCount) {
  if (lesson_.reference == nullptr || !is_canonical(lesson_.reference->skeleton)) {
    throw std::invalid_argument("virtual learner: expected a canonical reference");
  }
  std::uniform_real_distribution<double> turn(0.0, 2.0 * std::numbers::pi);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    noise_[j].setZero();
    aim_[j].setZero();
    under_way_[j].setZero();
    // The pelvis is turned as a whole; what counts of it is tilt.
    bias_[j] = possible(j, p_.bias * normal_vector(body_random_));
    for (auto& quarter : bias_of_quarter_[j]) {
      quarter = possible(j, p_.bias_of_quarter * normal_vector(body_random_));
    }
    tremor_phase_[j] = turn(body_random_);
    if (lesson_.weight[j] > 0.0) continue;
    bias_[j].setZero();
    for (auto& quarter : bias_of_quarter_[j]) quarter.setZero();
  }
}

Eigen::Vector3d VirtualLearner::possible(std::size_t joint,
                                         const Eigen::Vector3d& rotation) const noexcept {
  const JointAnatomy& anatomy = canonical_anatomy()[joint];
  if (joint == index(Joint::kPelvis)) return {rotation.x(), rotation.y(), 0.0};
  Eigen::Vector3d done = Eigen::Vector3d::Zero();
  for (std::size_t m = 0; m < anatomy.axis.size(); ++m) {
    if (can(anatomy.range[m])) done += rotation.dot(anatomy.axis[m]) * anatomy.axis[m];
  }
  return done;
}

double VirtualLearner::share() const noexcept {
  const double duration = lesson_.reference->duration();
  switch (part_) {
    case Part::kReady:
      return 0.0;
    case Part::kMove:
      return duration > 0.0 ? std::min(1.0, in_part_ * tempo_ / duration) : 1.0;
    case Part::kHold:
    case Part::kReturn:
      break;
  }
  return 1.0;
}

std::optional<double> VirtualLearner::reference_time() const noexcept {
  if (part_ != Part::kMove) return std::nullopt;
  return share() * lesson_.reference->duration();
}

Eigen::Vector3d VirtualLearner::offset(std::size_t joint, double share) const noexcept {
  const auto hats = quarters_at(share);
  Eigen::Vector3d sum =
      bias_[joint] + memory_.correction(joint, share, cued_ || cued_before_) + under_way_[joint];
  for (std::size_t q = 0; q < kQuarters; ++q) sum += hats[q] * bias_of_quarter_[joint][q];
  return sum;
}

void VirtualLearner::feel(double time, const std::array<double, wire::kTactorCount>& amplitude) {
  sense_.feel(time, amplitude);
}

void VirtualLearner::correct(std::size_t joint, const Eigen::Vector3d& by) {
  aim_[joint] += by;
  while (!begun_.empty() && begun_.front().time < time_ - kRemembered) begun_.pop_front();
  begun_.push_back({time_, joint, by});
}

Eigen::Vector3d VirtualLearner::left_of(const Eigen::Vector3d& needed, std::size_t joint,
                                        double showed) const noexcept {
  if (!p_.predicts || needed.isZero()) return needed;
  const Eigen::Vector3d way = needed.normalized();
  double left = needed.norm();
  for (const Correction& correction : begun_) {
    if (correction.joint == joint && correction.time > showed) left -= correction.by.dot(way);
  }
  return std::max(0.0, left) * way;
}

// A person who was told: this site is on this side of this limb; move it away from there.
void VirtualLearner::act(const FeltCue& cue) {
  cued_ = true;
  const std::size_t j = index(cue.segment);
  Eigen::Vector3d asked;
  if (cue.rotation) {
    asked = {0.0, 0.0, cue.positive ? 1.0 : -1.0};
  } else {
    const double side = lesson_.repulsive ? -1.0 : 1.0;
    const Eigen::Vector3d towards(side * std::cos(cue.angle), side * std::sin(cue.angle), 0.0);
    const Eigen::Vector3d& limb = lesson_.reference->skeleton[j].p_BE;
    if (!(limb.norm() > 0.0)) return;
    // v with v x limb along the wanted movement.
    asked = limb.normalized().cross(towards);
    if (!(asked.norm() > 0.0)) return;
    asked.normalize();
  }
  const Eigen::Vector3d doable = possible(j, asked);
  if (doable.norm() < kLeastPossible) return;
  const double size = p_.faintest_means + (p_.strongest_means - p_.faintest_means) * [&] {
    // Equal ratios of strength were told to be equal steps, from 0.3 to 1.
    return std::clamp(std::log(std::max(cue.strength, 1e-3) / 0.3) / std::log(1.0 / 0.3), 0.0, 1.0);
  }();
  const Eigen::Vector3d needed = size * doable.normalized();
  ++reactions_;
  // What the movement needs as it was meant is what is still missing and what was corrected
  // already.
  if (part_ == Part::kMove) {
    ++(needed.dot(offset(j, share()) + noise_[j]) < 0.0 ? right_ : wrong_);
    memory_.note(j, share(), needed + under_way_[j], true);
  }
  correct(j, p_.share * left_of(needed, j, cue.felt));
}

void VirtualLearner::look(double time) {
  // Drawn whether the expert is seen or not, so that two learners stay comparable.
  while (time >= next_glance_) {
    next_glance_ += p_.glance;
    std::discrete_distribution<std::size_t> where(lesson_.weight.begin(), lesson_.weight.end());
    const std::size_t j = where(sight_random_);
    const Eigen::Vector3d noise = p_.visual_noise * normal_vector(sight_random_);
    if (!sees_ || part_ != Part::kMove) continue;
    // What is still missing; as long as it is not below what can be seen.
    Eigen::Vector3d needed = possible(j, -(offset(j, share()) + noise_[j]) + noise);
    if (needed.norm() < p_.visual_dead_zone) needed.setZero();
    memory_.note(j, share(), needed.isZero() ? under_way_[j] : needed + under_way_[j], false);
    if (!needed.isZero()) seen_.push_back({time + p_.visual_delay, time, j, needed});
  }
  while (!seen_.empty() && time >= seen_.front().due) {
    const Sight& sight = seen_.front();
    correct(sight.joint, p_.share * left_of(sight.needed, sight.joint, sight.seen));
    seen_.pop_front();
  }
}

void VirtualLearner::go_on(double dt) {
  const double keep = std::exp(-dt / p_.noise_time);
  const double fresh = p_.noise * std::sqrt(1.0 - keep * keep);
  const double follow = -std::expm1(-dt / p_.movement_time), stay = std::exp(-dt / p_.drift_time);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    noise_[j] = keep * noise_[j] + fresh * normal_vector(noise_random_);
    aim_[j] *= stay;
    under_way_[j] += follow * (aim_[j] - under_way_[j]);
  }
  in_part_ += dt;
  const double move = lesson_.reference->duration() / tempo_;
  const auto next = [&](Part part, double lasted) {
    in_part_ -= lasted;
    part_ = part;
  };
  if (part_ == Part::kReady && in_part_ >= kReady) {
    next(Part::kMove, kReady);
  } else if (part_ == Part::kMove && in_part_ >= move) {
    next(Part::kHold, move);
  } else if (part_ == Part::kHold && in_part_ >= kHold) {
    next(Part::kReturn, kHold);
    end_pose_ = pose_;
  } else if (part_ == Part::kReturn && in_part_ >= kReturn) {
    next(Part::kReady, kReturn);
    memory_.learn(cued_);
    cued_before_ = cued_;
    cued_ = false;
    ++repetitions_;
    for (auto& aim : aim_) aim.setZero();  // the next one is begun as it is meant
    std::normal_distribution<double> normal;
    tempo_ = std::clamp(1.0 + p_.tempo * normal(noise_random_), 0.5, 2.0);
  }
}

const Pose& VirtualLearner::move(double time) {
  if (began_ && time > time_) go_on(time - time_);
  if (!began_) next_glance_ = time;
  began_ = true;
  time_ = time;
  for (const FeltCue& cue : sense_.react(time)) act(cue);
  look(time);

  // On the way back it is going to where the motion begins.
  const double to = part_ == Part::kReturn ? 0.0 : share();
  sample(*lesson_.reference, to * lesson_.reference->duration(), reference_pose_);
  pose_.p_WR = reference_pose_.p_WR;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const double tremor = p_.tremor * std::sqrt(2.0) *
                          std::sin(2.0 * std::numbers::pi * p_.tremor_hz * time + tremor_phase_[j]);
    const Eigen::Vector3d shaken =
        offset(j, to) + possible(j, noise_[j] + Eigen::Vector3d::Constant(tremor));
    pose_.q_PB[j] = (reference_pose_.q_PB[j] * quaternion_from(shaken)).normalized();
  }
  if (part_ == Part::kReturn) {
    const double gone = std::min(1.0, in_part_ / kReturn);
    const Pose there = pose_;
    interpolate(end_pose_, there, gone * gone * (3.0 - 2.0 * gone), pose_);
  }
  return pose_;
}

void VirtualLearner::rest(double seconds) noexcept {
  memory_.rest(seconds);
  time_ += seconds;
  next_glance_ += seconds;
  cued_ = cued_before_ = false;
  for (auto& aim : aim_) aim.setZero();
  for (auto& under_way : under_way_) under_way.setZero();
  seen_.clear();
}

}  // namespace secondskin::sim
