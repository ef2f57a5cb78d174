#include "coach/tactile/tactile_mapper.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

// Strength (docs/tactile.md, table "Strength").
constexpr int kSteps = 5;
constexpr double kFullScale = 30.0 * kDegree;  // beyond the dead band: the strongest cue
constexpr double kStepHysteresis = 0.25;       // of a step
constexpr int kFirstPulsedStep = 4;
constexpr double kNoticeableRatio = 1.2;  // amplitude JND 17-21 %
// A joint is cued from a tenth beyond its dead band, and until the dead band itself.
constexpr double kOnsetMargin = 1.1;

// Where.
constexpr double kLeastFit = 0.3;  // a tactor further than 72 degrees off the side says nothing
constexpr double kFitHysteresis = 0.15;
constexpr double kKindHysteresis = 1.25;  // rotation against swing
constexpr double kSwingWithoutRing =
    0.5;  // of the rotation: below, a joint without ring is not cued

// Which: a challenger takes a cue's place when it is better by this.
constexpr double kBenefitRatio = 1.2;
constexpr double kBenefitMargin = 0.02;

constexpr std::size_t kRingSize = 4;

// Joints that hang together without branching, proximal first: a cue never leaves its limb.
struct Limb {
  Joint first, last;
};
constexpr std::array<Limb, 6> kLimbs{{{Joint::kPelvis, Joint::kSpineUpper},
                                      {Joint::kNeck, Joint::kHead},
                                      {Joint::kLeftClavicle, Joint::kLeftWrist},
                                      {Joint::kRightClavicle, Joint::kRightWrist},
                                      {Joint::kLeftHip, Joint::kLeftToes},
                                      {Joint::kRightHip, Joint::kRightToes}}};

double wrapped(double angle) noexcept { return std::remainder(angle, 2.0 * std::numbers::pi); }

double seconds(std::int64_t ns) noexcept { return 1e-9 * static_cast<double>(ns); }

double faintest_level(double threshold) noexcept {
  return std::max(threshold, wire::drive_of(wire::kFaintestIntensity).level);
}

bool usable(const Tactor& tactor) noexcept { return faintest_level(0.0) <= tactor.ceiling; }

bool wears(const BodyMap& map, std::size_t segment) {
  return std::any_of(map.tactors.begin(), map.tactors.end(),
                     [&](const Tactor& t) { return index(t.segment) == segment && usable(t); });
}

// +1 when channels 4g to 4g+3 go round the segment counterclockwise, -1 the other way, 0 when they
// are no ring: not on one segment, not in order, with motors too slow for taps, or forbidden.
int ring_direction(const BodyMap& map, std::size_t group) {
  std::array<const Tactor*, kRingSize> ring{};
  for (const Tactor& tactor : map.tactors) {
    if (tactor.channel / kRingSize == group) ring[tactor.channel % kRingSize] = &tactor;
  }
  int direction = 0;
  double round = 0.0;
  for (std::size_t i = 0; i < kRingSize; ++i) {
    const Tactor *here = ring[i], *next = ring[(i + 1) % kRingSize];
    if (here == nullptr || next == nullptr) return 0;
    if (here->segment != next->segment || here->actuator != wire::Actuator::kVoiceCoil) return 0;
    if (!usable(*here)) return 0;
    const double step = wrapped(next->angle - here->angle);
    const int sign = step > 0.0 ? 1 : -1;
    if (std::abs(step) < 1e-6 || (direction != 0 && sign != direction)) return 0;
    direction = sign;
    round += step;
  }
  // In order and all one way they close after exactly one turn.
  return std::abs(std::abs(round) - 2.0 * std::numbers::pi) < 1e-6 ? direction : 0;
}

// The step for a strength, kept until it is left by a quarter of a step. [1, kSteps]
int next_step(double strength, int present) noexcept {
  const double at = std::clamp(strength, 0.0, 1.0) * kSteps;
  const int fresh = std::min(kSteps, 1 + static_cast<int>(at));
  if (fresh < present && at > present - 1 - kStepHysteresis) return present;
  if (fresh > present && at < present + kStepHysteresis && present > 0) return present;
  return fresh;
}

// Steps are equal ratios from threshold to ceiling, and no more of them than can be told apart. The
// board's intensities are rounded, never above the ceiling.
std::uint8_t intensity_for_step(int step, double threshold, double ceiling) noexcept {
  const double faintest = std::min(faintest_level(threshold), ceiling);
  const int distinct = std::clamp(
      1 + static_cast<int>(std::log(ceiling / faintest) / std::log(kNoticeableRatio) + 1e-9), 1,
      kSteps);
  // ceil: the top step is always the ceiling.
  const int rank = (step * distinct + kSteps - 1) / kSteps;
  const double share =
      distinct == 1 ? 1.0 : static_cast<double>(rank - 1) / static_cast<double>(distinct - 1);
  std::uint8_t intensity =
      wire::intensity_for_level(faintest * std::pow(ceiling / faintest, share));
  while (intensity > wire::kFaintestIntensity && wire::drive_of(intensity).level > ceiling) {
    --intensity;
  }
  return intensity;
}

}  // namespace

TactileMapper::TactileMapper(BodyMap map, const TactileOptions& options)
    : map_(std::move(map)), options_(options) {
  const Skeleton body = canonical_skeleton();
  std::array<Eigen::Vector3d, kJointCount> p_WB;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    p_WB[j] = body[j].parent ? Eigen::Vector3d(p_WB[*body[j].parent] + body[j].p_PB)
                             : Eigen::Vector3d::Zero();
  }
  for (const Limb& limb : kLimbs) {
    for (std::size_t j = index(limb.first); j <= index(limb.last); ++j) {
      // The joint's own segment, else the next one outward, else the next one inward.
      std::optional<std::size_t> found;
      for (std::size_t s = j; !found && s <= index(limb.last); ++s) {
        if (wears(map_, s)) found = s;
      }
      for (std::size_t s = j; !found && s-- > index(limb.first);) {
        if (wears(map_, s)) found = s;
      }
      Site& site = sites_[j];
      site.lever = body[j].p_BE;
      if (!found) continue;
      site.worn = true;
      site.segment = static_cast<Joint>(*found);
      if (*found > j) site.lever = p_WB[*found] + 0.5 * body[*found].p_BE - p_WB[j];
      site.along_axis = std::abs(body[j].p_BE.normalized().z()) > 0.9;
      for (std::size_t group = 0; group < wire::kTactorCount / kRingSize && !site.ring; ++group) {
        const int direction = ring_direction(map_, group);
        if (direction == 0) continue;
        const auto of_ring = [&](const Tactor& t) { return t.channel == group * kRingSize; };
        const auto first = std::find_if(map_.tactors.begin(), map_.tactors.end(), of_ring);
        if (first->segment != site.segment) continue;
        site.ring = group;
        site.ring_counterclockwise = direction > 0;
      }
    }
  }
}

std::optional<TactileMapper::Place> TactileMapper::place(std::size_t joint,
                                                         const Eigen::Vector3d& target,
                                                         const Place* present) const noexcept {
  const Site& site = sites_[joint];
  if (!site.worn) return std::nullopt;
  const double twist = target.z();
  const double swing = std::hypot(target.x(), target.y());
  double rotation = site.along_axis ? std::abs(twist) : 0.0;
  if (present != nullptr) rotation *= present->rotation ? kKindHysteresis : 1.0 / kKindHysteresis;
  if (rotation > swing) {
    if (site.ring) {
      Place result;
      result.rotation = true;
      result.reverse = (twist > 0.0) != site.ring_counterclockwise;
      result.fit = 1.0;
      return result;
    }
    if (swing < kSwingWithoutRing * std::abs(twist)) return std::nullopt;
  }
  // How the limb is to move where the tactors are; about its own axis it does not move them.
  const Eigen::Vector3d axis =
      site.along_axis ? Eigen::Vector3d(target.x(), target.y(), 0.0) : target;
  const Eigen::Vector3d movement = axis.cross(site.lever);
  const double size = std::hypot(movement.x(), movement.y());
  if (!(size > kLeastFit * movement.norm())) return std::nullopt;
  const double side = map_.repulsive ? -1.0 : 1.0;
  std::optional<Place> best;
  for (std::size_t t = 0; t < map_.tactors.size(); ++t) {
    const Tactor& tactor = map_.tactors[t];
    if (tactor.segment != site.segment || !usable(tactor)) continue;
    double fit = side *
                 (std::cos(tactor.angle) * movement.x() + std::sin(tactor.angle) * movement.y()) /
                 size;
    if (fit < kLeastFit) continue;
    if (present != nullptr && !present->rotation && present->tactor == t) fit += kFitHysteresis;
    if (best && !(fit > best->fit)) continue;
    best = Place{};
    best->tactor = t;
    best->fit = fit;
  }
  return best;
}

void TactileMapper::write(std::size_t cue, wire::BoardState& board) noexcept {
  const Given& given = given_[cue];
  const Site& site = sites_[index(cues_[cue].joint)];
  double threshold = 0.0, ceiling = 1.0;
  if (given.place.rotation) {
    // A ring is as strong as its most tender site allows.
    for (const Tactor& tactor : map_.tactors) {
      if (tactor.channel / kRingSize != *site.ring) continue;
      threshold = std::max(threshold, tactor.threshold);
      ceiling = std::min(ceiling, tactor.ceiling);
    }
    threshold = std::min(threshold, ceiling);
    cues_[cue].slot =
        static_cast<std::uint8_t>(wire::saltation_slot(*site.ring, given.place.reverse));
  } else {
    const Tactor& tactor = map_.tactors[given.place.tactor];
    threshold = tactor.threshold;
    ceiling = tactor.ceiling;
    // A direct-current motor cannot follow pulses (Second Skin, 4.3).
    const bool pulsed =
        given.step >= kFirstPulsedStep && tactor.actuator == wire::Actuator::kVoiceCoil;
    cues_[cue].slot = static_cast<std::uint8_t>(pulsed ? wire::pulsed_slot(tactor.channel)
                                                       : wire::continuous_slot(tactor.channel));
  }
  cues_[cue].intensity = intensity_for_step(given.step, threshold, ceiling);
  board[cues_[cue].slot] = cues_[cue].intensity;
}

void TactileMapper::remove(std::size_t cue) noexcept {
  --cue_count_;
  for (std::size_t c = cue; c < cue_count_; ++c) {
    cues_[c] = cues_[c + 1];
    given_[c] = given_[c + 1];
  }
}

wire::BoardState TactileMapper::update(std::int64_t stamp_ns, const CorrectionResult& correction,
                                       const JointVectors& error,
                                       const std::array<double, kJointCount>& tolerance,
                                       bool enabled) noexcept {
  wire::BoardState board{};
  if (!enabled) {
    cue_count_ = 0;
    return board;
  }
  const bool solved = correction.status != SolverStatus::kNone;
  const auto asked = [&](std::size_t j) {
    return solved && correction.target[j].allFinite() && !correction.target[j].isZero();
  };
  const auto strength = [&](std::size_t j) {
    return (error[j].norm() - tolerance[j]) / kFullScale;
  };
  const auto benefit = [&](std::size_t j) { return solved ? correction.benefit[j] : 0.0; };

  const auto name_movement = [&](Cue& cue) {
    const auto& axes = canonical_anatomy()[index(cue.joint)].axis;
    const Eigen::Vector3d& target = correction.target[index(cue.joint)];
    std::size_t largest = 0;
    for (std::size_t m = 1; m < axes.size(); ++m) {
      if (std::abs(target.dot(axes[m])) > std::abs(target.dot(axes[largest]))) largest = m;
    }
    cue.movement = static_cast<Movement>(largest);
    cue.positive = target.dot(axes[largest]) > 0.0;
  };

  // What may be cued afresh, best first.
  struct Candidate {
    std::size_t joint;
    Place place;
  };
  std::array<Candidate, kJointCount> candidates;
  std::size_t count = 0;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (!asked(j) || !(error[j].norm() > kOnsetMargin * tolerance[j])) continue;
    if (std::any_of(cues_.begin(), cues_.begin() + static_cast<std::ptrdiff_t>(cue_count_),
                    [&](const Cue& cue) { return index(cue.joint) == j; })) {
      continue;
    }
    if (const auto where = place(j, correction.target[j], nullptr)) {
      candidates[count++] = {j, *where};
    }
  }
  std::sort(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(count),
            [&](const Candidate& a, const Candidate& b) {
              return benefit(a.joint) != benefit(b.joint) ? benefit(a.joint) > benefit(b.joint)
                                                          : a.joint < b.joint;
            });

  // What goes on. Inside the dead band a cue ends at once; anything else waits until it was felt.
  for (std::size_t c = cue_count_; c-- > 0;) {
    const std::size_t j = index(cues_[c].joint);
    Given& given = given_[c];
    given.onset_ns = std::min(given.onset_ns, stamp_ns);
    const bool felt = seconds(stamp_ns - given.onset_ns) >= options_.min_hold;
    if (!(error[j].norm() > tolerance[j])) {
      remove(c);
      continue;
    }
    if (!felt) continue;
    const auto where =
        asked(j) ? place(j, correction.target[j], &given.place) : std::optional<Place>{};
    if (!where) {
      remove(c);
      continue;
    }
    const bool same = where->rotation == given.place.rotation &&
                      (where->rotation ? where->reverse == given.place.reverse
                                       : where->tactor == given.place.tactor);
    if (!same) {
      // Another place is another cue.
      given.onset_ns = stamp_ns;
      given.place = *where;
      ++cues_given_;
      ++cues_by_joint_[index(cues_[c].joint)];
    }
    name_movement(cues_[c]);
  }

  // Who else. A segment speaks for one joint at a time.
  for (std::size_t n = 0; n < count; ++n) {
    const Candidate& candidate = candidates[n];
    const auto better = [&](std::size_t c) {
      const double old = benefit(index(cues_[c].joint));
      return seconds(stamp_ns - given_[c].onset_ns) >= options_.min_hold &&
             benefit(candidate.joint) > kBenefitRatio * old + kBenefitMargin;
    };
    std::optional<std::size_t> rival;
    for (std::size_t c = 0; c < cue_count_; ++c) {
      if (sites_[index(cues_[c].joint)].segment == sites_[candidate.joint].segment) rival = c;
    }
    if (!rival && cue_count_ >= options_.max_cues) {
      for (std::size_t c = 0; c < cue_count_; ++c) {
        if (!rival || benefit(index(cues_[c].joint)) < benefit(index(cues_[*rival].joint))) {
          rival = c;
        }
      }
      if (!rival) break;  // no cues are wanted at all
    }
    if (rival) {
      if (!better(*rival)) continue;
      remove(*rival);
    }
    cues_[cue_count_] = Cue{};
    cues_[cue_count_].joint = static_cast<Joint>(candidate.joint);
    name_movement(cues_[cue_count_]);
    given_[cue_count_] = {.onset_ns = stamp_ns, .place = candidate.place, .step = 0};
    ++cue_count_;
    ++cues_given_;
    ++cues_by_joint_[candidate.joint];
  }

  for (std::size_t c = 0; c < cue_count_; ++c) {
    const std::size_t j = index(cues_[c].joint);
    given_[c].step = next_step(strength(j), given_[c].step);
    write(c, board);
  }
  return board;
}

}  // namespace secondskin::coach
