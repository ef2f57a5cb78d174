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
constexpr double kSlowestTap = 0.100;  // classic range of saltation: 20 to 100 ms [s]

// Scaled by duration: on for so much of each period, at the middle step's level. A person tells
// durations apart from about a fifth.
constexpr double kPeriod = 1.0;  // [s]
constexpr int kScaledStep = 3;
constexpr double on_time(int step) noexcept { return 0.20 + 0.15 * (step - 1); }  // [s]

// Direct-current motors are pushed until this near the level that is asked for.
constexpr double kMotorReached = 0.95;
constexpr double kShortestFrame = 0.005, kUsualFrame = 0.0167, kLongestFrame = 0.050;  // [s]
const double kMotorTimeConstant = wire::kDcMotorRise / std::log(20.0);  // 95 % after the rise
constexpr double kNoticeableRatio = 1.2;                                // amplitude JND 17-21 %
// A joint is cued from a tenth beyond its dead band, and until the dead band itself.
constexpr double kOnsetMargin = 1.1;

// Where.
constexpr double kLeastFit = 0.3;  // a tactor further than 72 degrees off the side says nothing
constexpr double kFitHysteresis = 0.15;
// Around a limb a place is told from the next at about an eighth of a turn: no finer phantoms.
constexpr double kSpotSpacing = 45.0 * kDegree;
constexpr double kLongestArc = 135.0 * kDegree;  // to the next tactor: wider ones are felt as two
constexpr double kSameHeight = 0.25;             // of the segment's length
constexpr double kKindHysteresis = 1.25;         // rotation against swing
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
  // An error that is not a number counts as none.
  const double at = strength > 0.0 ? std::min(strength, 1.0) * kSteps : 0.0;
  const int fresh = std::min(kSteps, 1 + static_cast<int>(at));
  if (fresh < present && at > present - 1 - kStepHysteresis) return present;
  if (fresh > present && at < present + kStepHysteresis && present > 0) return present;
  return fresh;
}

// Steps are equal ratios from the faintest to the strongest, and no more of them than can be told
// apart.
double level_of_step(int step, double faintest, double strongest) noexcept {
  const int distinct = std::clamp(
      1 + static_cast<int>(std::log(strongest / faintest) / std::log(kNoticeableRatio) + 1e-9), 1,
      kSteps);
  // ceil: the top step is always the strongest.
  const int rank = (step * distinct + kSteps - 1) / kSteps;
  if (rank == distinct) return strongest;
  const double share = static_cast<double>(rank - 1) / static_cast<double>(distinct - 1);
  return faintest * std::pow(strongest / faintest, share);
}

// The board's intensities are rounded, never above the ceiling.
std::uint8_t intensity_within(double level, double ceiling) noexcept {
  std::uint8_t intensity = wire::intensity_for_level(level);
  while (intensity > wire::kFaintestIntensity && wire::drive_of(intensity).level > ceiling) {
    --intensity;
  }
  return intensity;
}

// The level at which saltation taps come as fast as the classic range asks.
double slowest_tap_level() noexcept {
  std::uint8_t intensity = wire::kFaintestIntensity;
  while (wire::drive_of(intensity).tap_interval > kSlowestTap) ++intensity;
  return wire::drive_of(intensity).level;
}

// The amplitudes that a phantom of two tactors can have: each at least felt, and none above either
// ceiling. Empty if first > second.
std::array<double, 2> phantom_range(const Tactor& a, const Tactor& b, double beta) noexcept {
  const auto [wa, wb] = phantom_weights(beta);
  return {std::max(faintest_level(a.threshold) / wa, faintest_level(b.threshold) / wb),
          std::min(a.ceiling, b.ceiling)};
}

bool phantom_possible(const Tactor& a, const Tactor& b, double beta) noexcept {
  const auto continuous = phantom_range(a, b, beta), pulsed = phantom_range(a, b, 0.5);
  return continuous[0] <= continuous[1] && pulsed[0] <= pulsed[1];
}

}  // namespace

std::array<double, 2> phantom_weights(double beta) noexcept {
  return {std::sqrt(1.0 - beta), std::sqrt(beta)};
}

TactileMapper::TactileMapper(BodyMap map, const TactileOptions& options,
                             const ExposureState& exposure)
    : map_(std::move(map)), options_(options), limiter_(map_, exposure) {
  for (std::size_t segment = 0; segment < kJointCount; ++segment) {
    std::vector<Spot>& spots = spots_[segment];
    for (std::size_t t = 0; t < map_.tactors.size(); ++t) {
      const Tactor& tactor = map_.tactors[t];
      if (index(tactor.segment) != segment || !usable(tactor)) continue;
      spots.push_back({.first = t, .second = t, .angle = wrapped(tactor.angle)});
    }
    std::sort(spots.begin(), spots.end(),
              [](const Spot& a, const Spot& b) { return a.angle < b.angle; });
    const std::size_t worn = spots.size();
    for (std::size_t i = 0; worn > 1 && i < worn; ++i) {
      const Spot here = spots[i], next = spots[(i + 1) % worn];
      const Tactor &a = map_.tactors[here.first], &b = map_.tactors[next.first];
      double arc = next.angle - here.angle;
      if (i + 1 == worn) arc += 2.0 * std::numbers::pi;
      if (arc > kLongestArc || a.actuator != b.actuator ||
          std::abs(a.along - b.along) > kSameHeight || (a.no_phantom_with >> b.channel & 1u) != 0 ||
          (b.no_phantom_with >> a.channel & 1u) != 0) {
        continue;
      }
      const int parts = static_cast<int>(std::ceil(arc / kSpotSpacing - 1e-6));
      for (int part = 1; part < parts; ++part) {
        const double beta = static_cast<double>(part) / parts;
        if (!phantom_possible(a, b, beta)) continue;
        spots.push_back({here.first, next.first, beta, here.angle + beta * arc});
      }
    }
  }
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
                                                         const Place* present, bool rested_only,
                                                         bool alarm) const noexcept {
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
      if (!rested_only || !rests(joint, result, alarm)) return result;
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
  const std::vector<Spot>& spots = spots_[index(site.segment)];
  std::optional<Place> best;
  for (std::size_t s = 0; s < spots.size(); ++s) {
    Place at;
    at.spot = s;
    at.fit = side *
             (std::cos(spots[s].angle) * movement.x() + std::sin(spots[s].angle) * movement.y()) /
             size;
    if (at.fit < kLeastFit || (rested_only && rests(joint, at, alarm))) continue;
    if (present != nullptr && !present->rotation && present->spot == s) at.fit += kFitHysteresis;
    if (!best || at.fit > best->fit) best = at;
  }
  return best;
}

double TactileMapper::tells(Joint joint, const Eigen::Vector3d& target) const noexcept {
  const double size = target.norm();
  const auto at = place(index(joint), target, nullptr, false, false);
  if (!at || !(size > 0.0)) return 0.0;
  if (at->rotation) return std::abs(target.z()) / size;
  if (!sites_[index(joint)].along_axis) return at->fit;
  return at->fit * std::hypot(target.x(), target.y()) / size;
}

JointSet TactileMapper::served() const noexcept {
  JointSet joints;
  for (std::size_t j = 0; j < kJointCount; ++j) joints[j] = sites_[j].worn;
  return joints;
}

bool TactileMapper::rests(std::size_t joint, const Place& place, bool alarm) const noexcept {
  const Site& site = sites_[joint];
  if (place.rotation) {
    for (std::size_t i = 0; i < kRingSize; ++i) {
      if (limiter_.rests(*site.ring * kRingSize + i, alarm)) return true;
    }
    return false;
  }
  const Spot& spot = spots_[index(site.segment)][place.spot];
  return limiter_.rests(map_.tactors[spot.first].channel, alarm) ||
         limiter_.rests(map_.tactors[spot.second].channel, alarm);
}

void TactileMapper::write(std::size_t c, std::int64_t stamp_ns, wire::BoardState& board) noexcept {
  const Given& given = given_[c];
  const Site& site = sites_[index(cues_[c].joint)];
  Cue& cue = cues_[c];
  cue.second_slot.reset();
  cue.second_intensity = 0;
  if (given.place.rotation) {
    // A ring is as strong as its most tender site allows.
    static const double slowest = slowest_tap_level();
    double threshold = slowest, ceiling = 1.0;
    for (const Tactor& tactor : map_.tactors) {
      if (tactor.channel / kRingSize != *site.ring) continue;
      threshold = std::max(threshold, tactor.threshold);
      ceiling = std::min(ceiling, tactor.ceiling);
    }
    cue.slot = static_cast<std::uint8_t>(wire::saltation_slot(*site.ring, given.place.reverse));
    cue.intensity =
        intensity_within(level_of_step(given.step, std::min(threshold, ceiling), ceiling), ceiling);
    board[cue.slot] = cue.intensity;
    return;
  }
  const Spot& spot = spots_[index(site.segment)][given.place.spot];
  const Tactor &first = map_.tactors[spot.first], &second = map_.tactors[spot.second];
  const bool scaled = options_.duration_scaled && !cue.alarm;
  const int step = scaled ? kScaledStep : given.step;
  // A direct-current motor cannot follow pulses (Second Skin, 4.3).
  const bool pulsed =
      !scaled && given.step >= kFirstPulsedStep && first.actuator == wire::Actuator::kVoiceCoil;
  const auto slot = [&](const Tactor& tactor) {
    return static_cast<std::uint8_t>(pulsed ? wire::pulsed_slot(tactor.channel)
                                            : wire::continuous_slot(tactor.channel));
  };
  const bool pause =
      scaled && std::fmod(seconds(stamp_ns - given.onset_ns), kPeriod) >= on_time(given.step);
  cue.slot = slot(first);
  if (!spot.is_phantom()) {
    const double faintest = std::min(faintest_level(first.threshold), first.ceiling);
    cue.intensity =
        pause ? std::uint8_t{0}
              : intensity_within(level_of_step(step, faintest, first.ceiling), first.ceiling);
    board[cue.slot] = cue.intensity;
    return;
  }
  cue.second_slot = slot(second);
  // One byte is level and rate: two pulses keep in step only if both are the same.
  const double beta = pulsed ? 0.5 : spot.beta;
  const auto [wa, wb] = phantom_weights(beta);
  const auto [faintest, strongest] = phantom_range(first, second, beta);
  const double amplitude = level_of_step(step, faintest, strongest);
  cue.intensity = pause ? std::uint8_t{0} : intensity_within(wa * amplitude, first.ceiling);
  cue.second_intensity = pause ? std::uint8_t{0} : intensity_within(wb * amplitude, second.ceiling);
  if (pulsed) cue.intensity = cue.second_intensity = std::min(cue.intensity, cue.second_intensity);
  board[cue.slot] = cue.intensity;
  board[*cue.second_slot] = cue.second_intensity;
}

// A motor's vibration follows its drive u as a' = (u - a) / tau. To be at the level one frame from
// now it would need u = a + (level - a) / (1 - exp(-dt / tau)); it gets that, but never more than
// its ceiling.
void TactileMapper::start_motors(double dt, wire::BoardState& board) noexcept {
  const double lived = std::min(dt, options_.command_lifetime);
  const double frame = dt > 0.0 ? std::clamp(dt, kShortestFrame, kLongestFrame) : kUsualFrame;
  for (const Tactor& tactor : map_.tactors) {
    if (tactor.actuator != wire::Actuator::kDcMotor) continue;
    double& a = motor_[tactor.channel];
    const std::size_t slot = wire::continuous_slot(tactor.channel);
    const double was = wire::drive_of(last_board_[slot]).level;
    a += (was - a) * -std::expm1(-lived / kMotorTimeConstant);
    a *= std::exp(-(dt - lived) / kMotorTimeConstant);
    const double level = wire::drive_of(board[slot]).level;
    if (level <= 0.0 || a >= kMotorReached * level) continue;
    const double push = a + (level - a) / -std::expm1(-frame / kMotorTimeConstant);
    board[slot] =
        std::max(board[slot], intensity_within(std::min(push, tactor.ceiling), tactor.ceiling));
  }
}

double TactileMapper::least_hold(std::size_t c) const noexcept {
  if (!given_[c].place.rotation) return options_.min_hold;
  const double round = static_cast<double>(kRingSize) * wire::kTapsPerSite *
                       wire::drive_of(cues_[c].intensity).tap_interval;
  return std::max(options_.min_hold, round);
}

void TactileMapper::remove(std::size_t cue, std::int64_t stamp_ns) noexcept {
  quiet_until_ns_[index(sites_[index(cues_[cue].joint)].segment)] =
      stamp_ns + std::llround(options_.pause * 1e9);
  --cue_count_;
  for (std::size_t c = cue; c < cue_count_; ++c) {
    cues_[c] = cues_[c + 1];
    given_[c] = given_[c + 1];
  }
}

wire::BoardState TactileMapper::update(std::int64_t stamp_ns, const CorrectionResult& correction,
                                       const JointVectors& error,
                                       const std::array<double, kJointCount>& tolerance,
                                       bool enabled, const SafeRangeAlarm* alarm) noexcept {
  const double dt = last_stamp_ns_ == 0 ? 0.0 : std::max(0.0, seconds(stamp_ns - last_stamp_ns_));
  limiter_.advance(stamp_ns, last_board_, options_.command_lifetime);

  const bool solved = enabled && correction.status != SolverStatus::kNone;
  const auto alarmed = [&](std::size_t j) { return alarm != nullptr && alarm->excess[j] > 0.0; };
  const auto wanted = [&](std::size_t j) -> const Eigen::Vector3d& {
    return alarmed(j) ? alarm->target[j] : correction.target[j];
  };
  const auto asked = [&](std::size_t j) {
    return (alarmed(j) || solved) && wanted(j).allFinite() && !wanted(j).isZero();
  };
  const auto strength = [&](std::size_t j) {
    return (error[j].norm() - tolerance[j]) / kFullScale;
  };
  // Among alarms, how far outside; among corrections, the benefit.
  const auto rank = [&](std::size_t j) {
    return alarmed(j) ? alarm->excess[j] : solved ? correction.benefit[j] : 0.0;
  };

  const auto name_movement = [&](Cue& cue) {
    const auto& axes = canonical_anatomy()[index(cue.joint)].axis;
    const Eigen::Vector3d& target = wanted(index(cue.joint));
    std::size_t largest = 0;
    for (std::size_t m = 1; m < axes.size(); ++m) {
      if (std::abs(target.dot(axes[m])) > std::abs(target.dot(axes[largest]))) largest = m;
    }
    cue.movement = static_cast<Movement>(largest);
    cue.positive = target.dot(axes[largest]) > 0.0;
  };
  const auto is_felt = [&](std::size_t c) {
    const double lasted = seconds(stamp_ns - given_[c].onset_ns);
    if (!options_.duration_scaled || cues_[c].alarm || given_[c].place.rotation) {
      return lasted >= least_hold(c);
    }
    return lasted >= options_.min_hold &&
           std::fmod(lasted, kPeriod) >= std::min(options_.min_hold, on_time(given_[c].step));
  };

  const auto is_said = [&](std::size_t c) {
    if (cues_[c].alarm || (options_.duration_scaled && !given_[c].place.rotation)) return false;
    return seconds(stamp_ns - given_[c].onset_ns) >= std::max(options_.max_hold, least_hold(c));
  };

  // What goes on. Off at once: what may not be, and what must rest. Anything else waits until it
  // was felt.
  for (std::size_t c = cue_count_; c-- > 0;) {
    const std::size_t j = index(cues_[c].joint);
    Given& given = given_[c];
    given.onset_ns = std::min(given.onset_ns, stamp_ns);
    const bool may_be = cues_[c].alarm ? alarm != nullptr : solved;
    if (!may_be || (alarmed(j) && !cues_[c].alarm)) {  // the alarm is another cue
      remove(c, stamp_ns);
      continue;
    }
    const bool rest = rests(j, given.place, cues_[c].alarm);
    if (!rest && !is_felt(c)) continue;
    const bool over =
        cues_[c].alarm ? !alarmed(j) : is_said(c) || !(error[j].norm() > tolerance[j]);
    const auto where = !over && asked(j) ? place(j, wanted(j), &given.place, true, cues_[c].alarm)
                                         : std::optional<Place>{};
    if (!where) {
      remove(c, stamp_ns);
      continue;
    }
    const bool same =
        where->rotation == given.place.rotation &&
        (where->rotation ? where->reverse == given.place.reverse : where->spot == given.place.spot);
    if (!same) {
      // Another place is another cue.
      given.onset_ns = stamp_ns;
      given.place = *where;
      ++cues_given_;
      ++cues_by_joint_[j];
    }
    name_movement(cues_[c]);
  }

  // What may be cued afresh: alarms first, then the best.
  struct Candidate {
    std::size_t joint;
    bool alarm;
    Place place;
  };
  std::array<Candidate, kJointCount> candidates;
  std::size_t count = 0;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (!asked(j)) continue;
    if (!alarmed(j) && (!(error[j].norm() > kOnsetMargin * tolerance[j]) ||
                        stamp_ns < quiet_until_ns_[index(sites_[j].segment)])) {
      continue;
    }
    if (std::any_of(cues_.begin(), cues_.begin() + static_cast<std::ptrdiff_t>(cue_count_),
                    [&](const Cue& cue) { return index(cue.joint) == j; })) {
      continue;
    }
    if (const auto where = place(j, wanted(j), nullptr, true, alarmed(j))) {
      candidates[count++] = {j, alarmed(j), *where};
    }
  }
  std::sort(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(count),
            [&](const Candidate& a, const Candidate& b) {
              if (a.alarm != b.alarm) return a.alarm;
              return rank(a.joint) != rank(b.joint) ? rank(a.joint) > rank(b.joint)
                                                    : a.joint < b.joint;
            });

  // Who else. A segment speaks for one joint at a time.
  for (std::size_t n = 0; n < count; ++n) {
    const Candidate& candidate = candidates[n];
    const auto better = [&](std::size_t c) {
      if (candidate.alarm != cues_[c].alarm) return candidate.alarm;
      return is_felt(c) &&
             rank(candidate.joint) > kBenefitRatio * rank(index(cues_[c].joint)) + kBenefitMargin;
    };
    const std::size_t most =
        candidate.alarm ? std::max<std::size_t>(1, options_.max_cues) : options_.max_cues;
    std::optional<std::size_t> rival;
    for (std::size_t c = 0; c < cue_count_; ++c) {
      if (sites_[index(cues_[c].joint)].segment == sites_[candidate.joint].segment) rival = c;
    }
    if (!rival && cue_count_ >= most) {
      const auto lesser = [&](std::size_t a, std::size_t b) {
        if (cues_[a].alarm != cues_[b].alarm) return cues_[b].alarm;
        return rank(index(cues_[a].joint)) < rank(index(cues_[b].joint));
      };
      for (std::size_t c = 0; c < cue_count_; ++c) {
        if (!rival || lesser(c, *rival)) rival = c;
      }
      if (!rival) break;  // no cues are wanted at all
    }
    if (rival) {
      if (!better(*rival)) continue;
      remove(*rival, stamp_ns);
    }
    cues_[cue_count_] = Cue{};
    cues_[cue_count_].joint = static_cast<Joint>(candidate.joint);
    cues_[cue_count_].alarm = candidate.alarm;
    name_movement(cues_[cue_count_]);
    given_[cue_count_] = {.onset_ns = stamp_ns, .place = candidate.place, .step = 0};
    ++cue_count_;
    ++cues_given_;
    ++cues_by_joint_[candidate.joint];
  }

  wire::BoardState board{};
  for (std::size_t c = 0; c < cue_count_; ++c) {
    const std::size_t j = index(cues_[c].joint);
    given_[c].step = cues_[c].alarm ? kSteps : next_step(strength(j), given_[c].step);
    write(c, stamp_ns, board);
  }
  start_motors(dt, board);
  last_board_ = board;
  last_stamp_ns_ = stamp_ns;
  return board;
}

}  // namespace secondskin::coach
