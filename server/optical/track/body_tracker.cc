#include "server/optical/track/body_tracker.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <utility>

#include "wire/photo_tag.h"

namespace secondskin::server {
namespace {

// Fewer do not show how a segment turns.
constexpr std::size_t kFewestMembers = 3;
// A detector is placed when it is known so well [m].
constexpr double kPlaceSigma = 0.015;
// A segment whose orientation is known worse is begun anew: the filter is linear [rad].
constexpr double kMostTurnSigma = 0.5;
// Cycles that a detector has to keep its place to be put there; twice as many each time that it
// did not fit. A detector of another limb is not still against this one for long.
constexpr int kProof = 8;
constexpr int kMostProof = 2048;
// Cycles that a new segment's detectors have to agree, tracked by themselves beside it.
constexpr int kTrial = 16;
// A point is given out when so many times more of the cycle's values fit than do not.
constexpr int kClean = 2;
// Longer gaps lose every segment [cycles].
constexpr std::uint64_t kLongestGap = 32;

}  // namespace

BodyTracker::BodyTracker(const ProjectorRig& rig, std::span<const std::size_t> segment_of,
                         const BodyTrackerOptions& options)
    : rig_(rig),
      options_(options),
      cycle_time_(1e-9 * static_cast<double>(wire::cycle_ns(rig.size()))),
      singles_(rig, segment_of.size(), options.detector),
      placed_(segment_of.size(), 0) {
  if (!(options.stay > 0.0 && options.stay < 1.0)) {
    throw std::invalid_argument(
        fmt::format("stay: expected a probability between 0 and 1, found {}", options.stay));
  }
  for (std::size_t p = 0; p < rig.size(); ++p) {
    const double time = 1e-9 * static_cast<double>(wire::value_time_ns(p));
    leads_.push_back(options.detector.slot_times ? time - 0.5 * cycle_time_ : 0.0);
  }
  std::map<std::size_t, std::vector<Member>> members;
  for (std::size_t d = 0; d < segment_of.size(); ++d) {
    Member member{};
    member.detector = d;
    member.proof = kProof;
    members[segment_of[d]].push_back(member);
  }
  for (auto& [segment, list] : members) {
    if (list.size() < kFewestMembers) continue;
    segments_.push_back({SegmentFilter(list.size(), options.calm, options.prior),
                         SegmentFilter(list.size(), options.brisk, options.prior),
                         0.5,
                         std::move(list),
                         {}});
  }
}

void BodyTracker::reset(Segment& segment) noexcept {
  segment.calm.reset();
  segment.brisk.reset();
}

bool BodyTracker::on_trial(const Segment& segment) noexcept { return segment.age < kTrial; }

void BodyTracker::mix_and_predict(Segment& segment) const noexcept {
  const double w = segment.calm_share, stay = options_.stay;
  const double calm = stay * w + (1.0 - stay) * (1.0 - w);
  SegmentFilter::mix(segment.calm, segment.brisk, stay * w / calm, (1.0 - stay) * w / (1.0 - calm));
  segment.calm_share = calm;
  segment.calm.predict(cycle_time_);
  segment.brisk.predict(cycle_time_);
}

// Takes a cycle's values of all placed members in the order of their slots. Returns whether they
// agree with the segment.
bool BodyTracker::filter(Segment& segment, const ProjectorFrame& frame) noexcept {
  ValueGate& gate = singles_.gate_;
  for (Member& member : segment.members) member.used = member.gated = 0;
  double log_odds = 0.0;
  for (std::size_t p = 0; p < rig_.size(); ++p) {
    for (std::size_t i = 0; i < segment.members.size(); ++i) {
      if (!segment.calm.placed(i)) continue;
      Member& member = segment.members[i];
      const std::uint8_t value = frame.value(member.detector, p);
      if (value == wire::kNoValue || !rig_.projectors[p]) {
        gate.missing(member.detector, p);
        continue;
      }
      const Projector& projector = *rig_.projectors[p];
      const auto innovation = [&](SegmentFilter& filter) {
        const SegmentFilter::Point point = filter.point(i, leads_[p]);
        const double S =
            filter.innovation_variance(i, point, projector.gradient(point.p_WD), gate.variance());
        return std::pair{value - projector.value(point.p_WD), S};
      };
      const auto [calm_nu, calm_S0] = innovation(segment.calm);
      const auto [brisk_nu, brisk_S0] = innovation(segment.brisk);
      const auto variance =
          gate.admit(member.detector, p, brisk_nu,
                     std::min(calm_nu * calm_nu / calm_S0, brisk_nu * brisk_nu / brisk_S0));
      if (!variance) {
        ++member.gated;
        continue;
      }
      ++member.used;
      const double calm_S = calm_S0 + *variance - gate.variance();
      const double brisk_S = brisk_S0 + *variance - gate.variance();
      segment.calm.correct(calm_nu, calm_S);
      segment.brisk.correct(brisk_nu, brisk_S);
      log_odds -= 0.5 * (calm_nu * calm_nu / calm_S - brisk_nu * brisk_nu / brisk_S +
                         std::log(calm_S / brisk_S));
    }
  }
  // Bayes, for the odds of calm against brisk.
  const double odds =
      segment.calm_share / (1.0 - segment.calm_share) * std::exp(std::clamp(log_odds, -50.0, 50.0));
  segment.calm_share = std::clamp(odds / (1.0 + odds), 1e-6, 1.0 - 1e-6);

  int used = 0, gated = 0;
  bool lost = false;
  for (std::size_t i = 0; i < segment.members.size(); ++i) {
    if (!segment.calm.placed(i)) continue;
    Member& member = segment.members[i];
    used += member.used;
    gated += member.gated;
    member.strain.add(member.used, member.gated);
    if (member.strain.broken()) {
      member.kept = 0;
      member.proof = std::min(2 * member.proof, kMostProof);
      segment.calm.forget(i);
      segment.brisk.forget(i);
      lost = lost || on_trial(segment);  // who knows which of them is right
    }
  }
  segment.strain.add(used, gated);
  lost = lost || segment.strain.broken();
  lost = lost || !(segment.brisk.origin_sigma() <= options_.detector.lost_sigma &&
                   segment.brisk.turn_sigma() <= kMostTurnSigma);
  if (lost) reset(segment);
  ++segment.age;
  return !segment.strain.suspect();
}

// The members' points at the end of the cycle.
void BodyTracker::give(Segment& segment, MarkerFrame& out) const noexcept {
  for (std::size_t i = 0; i < segment.members.size(); ++i) {
    const Member& member = segment.members[i];
    if (!segment.calm.placed(i) || member.used == 0 || kClean * member.gated > member.used ||
        member.strain.suspect()) {
      continue;
    }
    const SegmentFilter::Point calm = segment.calm.point(i, 0.5 * cycle_time_);
    const SegmentFilter::Point brisk = segment.brisk.point(i, 0.5 * cycle_time_);
    const double w = segment.calm_share, u = 1.0 - w;
    const double calm_sigma = segment.calm.sigma(i, calm);
    const double brisk_sigma = segment.brisk.sigma(i, brisk);
    const double sigma = std::sqrt(w * calm_sigma * calm_sigma + u * brisk_sigma * brisk_sigma +
                                   w * u * (calm.p_WD - brisk.p_WD).squaredNorm());
    if (!(sigma <= options_.detector.visible_sigma)) continue;
    out.visible[member.detector] = 1;
    out.p_WM[member.detector] = w * calm.p_WD + u * brisk.p_WD;
    out.residual[member.detector] = static_cast<float>(sigma);
  }
}

std::optional<MovingPoint> BodyTracker::well_known(std::size_t detector) const noexcept {
  auto point = singles_.confirmed(detector);
  if (point && !(point->P_pp.trace() <= kPlaceSigma * kPlaceSigma)) point.reset();
  return point;
}

// With all detectors that are well known, if there are enough.
void BodyTracker::begin(Segment& segment) const noexcept {
  const double lead = 0.5 * cycle_time_;
  double n = 0.0;
  Eigen::Vector3d p = Eigen::Vector3d::Zero(), v = Eigen::Vector3d::Zero();
  const auto ready = [&](const Member& member) {
    return member.proof > kProof ? std::nullopt : well_known(member.detector);
  };
  for (Member& member : segment.members) {
    member.kept = 0;
    if (const auto point = ready(member)) {
      p += point->p;
      v += point->v;
      n += 1.0;
    }
  }
  if (n >= kFewestMembers) {
    segment.calm.begin((p - lead * v) / n, v / n);
    segment.brisk.begin((p - lead * v) / n, v / n);
    segment.calm_share = 0.5;
    segment.strain = {};
    segment.age = 0;
    for (std::size_t i = 0; i < segment.members.size(); ++i) {
      const auto point = ready(segment.members[i]);
      if (!point) continue;
      segment.calm.place(i, point->p, point->P_pp, lead);
      segment.brisk.place(i, point->p, point->P_pp, lead);
      segment.members[i].strain = {};
    }
    return;
  }
  // One that did not fit waits, and may then try again.
  for (Member& member : segment.members) member.proof = std::max(member.proof - 1, kProof);
}

// Puts detectors on their segment that have kept their place there.
void BodyTracker::place(Segment& segment) const noexcept {
  const double lead = 0.5 * cycle_time_;
  for (std::size_t i = 0; i < segment.members.size(); ++i) {
    Member& member = segment.members[i];
    if (segment.calm.placed(i)) continue;
    const auto point = well_known(member.detector);
    if (!point) continue;
    const SegmentFilter& likelier = segment.calm_share > 0.5 ? segment.calm : segment.brisk;
    const Eigen::Vector3d p_BD = likelier.on_limb(point->p, lead);
    const double sigma = std::sqrt(point->P_pp.trace());
    if (member.kept == 0 || (p_BD - member.p_BD).norm() > 2.0 * std::hypot(sigma, member.sigma)) {
      member.p_BD = p_BD;
      member.sigma = sigma;
      member.kept = 0;
    }
    if (++member.kept < member.proof) continue;
    segment.calm.place(i, point->p, point->P_pp, lead);
    segment.brisk.place(i, point->p, point->P_pp, lead);
    member.strain = {};
  }
}

void BodyTracker::update(const ProjectorFrame& frame, MarkerFrame& out) noexcept {
  const std::size_t n = placed_.size();
  if (out.p_WM.size() != n || out.visible.size() != n || out.residual.size() != n) {
    out = MarkerFrame(n);
  }
  if (cycle_ && (frame.cycle <= *cycle_ || frame.cycle - *cycle_ > kLongestGap)) {
    for (Segment& segment : segments_) reset(segment);
    cycle_.reset();
  }
  const bool fits = frame.detectors == n && frame.projectors == rig_.size() &&
                    frame.values.size() == n * rig_.size();
  const std::uint64_t cycles = cycle_ ? frame.cycle - *cycle_ : 0;
  cycle_ = frame.cycle;
  for (std::size_t d = 0; d < n; ++d) {
    out.visible[d] = 0;
    out.p_WM[d].setZero();
    out.residual[d] = 0.0F;
  }
  for (Segment& segment : segments_) {
    if (!segment.calm.active()) continue;
    for (std::uint64_t k = 0; k < cycles; ++k) mix_and_predict(segment);
    if (fits && filter(segment, frame) && !on_trial(segment)) give(segment, out);
  }
  for (const Segment& segment : segments_) {
    for (std::size_t i = 0; i < segment.members.size(); ++i) {
      placed_[segment.members[i].detector] = segment.calm.placed(i) && !on_trial(segment) ? 1 : 0;
    }
  }
  singles_.update(frame, placed_, out);
  for (Segment& segment : segments_) {
    if (segment.calm.active()) {
      place(segment);
    } else {
      begin(segment);
    }
  }
}

}  // namespace secondskin::server
