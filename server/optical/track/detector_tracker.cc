#include "server/optical/track/detector_tracker.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string_view>

#include "wire/photo_tag.h"

namespace secondskin::server {
namespace {

// Where a new track is thought to be before its first cycle's values: near enough to linearise,
// so far out that it weighs nothing beside them [m].
constexpr double kBeginSigma = 0.3;
// Of the first, robust solution, |A x - b| [counts]: a detector at 4 m/s is within.
constexpr double kBeginLimit = 10.0;
// A new track is given out after so many further cycles that agree with it.
constexpr int kAgreeingCycles = 3;
// A point is given out when so many times more of the cycle's values fit than do not.
constexpr int kClean = 2;
// Longer gaps lose every track [cycles].
constexpr std::uint64_t kLongestGap = 32;
// How near a projector a point may be, in units of the projector's distance from the origin.
constexpr double kNearest = 0.2;

void check(std::string_view name, double value) {
  if (!(value > 0.0 && std::isfinite(value))) {
    throw std::invalid_argument(fmt::format("{}: expected more than 0, found {}", name, value));
  }
}

}  // namespace

DetectorTracker::DetectorTracker(const ProjectorRig& rig, std::size_t detectors,
                                 const TrackerOptions& options)
    : rig_(rig),
      options_(options),
      cycle_time_(1e-9 * static_cast<double>(wire::cycle_ns(rig.size()))),
      gate_(detectors, rig.size(), options.noise),
      tracks_(detectors),
      planes_(rig.size()),
      slots_(rig.size()),
      used_planes_(rig.size()),
      take_(rig.size()) {
  check("calm.jerk", options.calm.jerk);
  check("calm.memory", options.calm.memory);
  check("brisk.jerk", options.brisk.jerk);
  check("brisk.memory", options.brisk.memory);
  check("stay", options.stay);
  check("1 - stay", 1.0 - options.stay);
  check("velocity_sigma", options.velocity_sigma);
  check("acceleration_sigma", options.acceleration_sigma);
  check("visible_sigma", options.visible_sigma);
  check("lost_sigma", options.lost_sigma);
  for (std::size_t p = 0; p < rig.size(); ++p) {
    if (rig.projectors[p] && !rig.projectors[p]->P.allFinite()) {
      throw std::invalid_argument(fmt::format("projector {}: expected seven finite numbers", p));
    }
    times_.push_back(options.slot_times ? 1e-9 * static_cast<double>(wire::value_time_ns(p))
                                        : 0.5 * cycle_time_);
  }
}

void DetectorTracker::mix(Track& track) const noexcept {
  const double w = track.calm_share, stay = options_.stay;
  const double calm = stay * w + (1.0 - stay) * (1.0 - w);
  const MovingPoint into_calm = blend(track.calm, track.brisk, stay * w / calm);
  track.brisk = blend(track.calm, track.brisk, (1.0 - stay) * w / (1.0 - calm));
  track.calm = into_calm;
  track.calm_share = calm;
}

void DetectorTracker::coast(Track& track, double dt) const noexcept {
  predict(track.calm, options_.calm, dt);
  predict(track.brisk, options_.brisk, dt);
}

// Takes a cycle's values in the order of their slots, and goes on to the cycle's end. Of `take`,
// where it is given, those with 0 are left out.
DetectorTracker::CycleResult DetectorTracker::filter(Track& track, std::size_t detector,
                                                     const ProjectorFrame& frame,
                                                     std::span<const std::uint8_t> take) noexcept {
  CycleResult result;
  double now = 0.0, log_odds = 0.0;
  for (std::size_t p = 0; p < rig_.size(); ++p) {
    const std::uint8_t value = frame.value(detector, p);
    if (value == wire::kNoValue || !rig_.projectors[p]) {
      gate_.missing(detector, p);
      continue;
    }
    if (!take.empty() && take[p] == 0) {
      ++result.gated;
      gate_.leave_out(detector, p);
      continue;
    }
    const Projector& projector = *rig_.projectors[p];
    coast(track, times_[p] - now);
    now = times_[p];
    Innovation calm = innovation(track.calm, projector.gradient(track.calm.p),
                                 value - projector.value(track.calm.p), gate_.variance());
    Innovation brisk = innovation(track.brisk, projector.gradient(track.brisk.p),
                                  value - projector.value(track.brisk.p), gate_.variance());
    const auto variance = gate_.admit(
        detector, p, brisk.nu, std::min(calm.nu * calm.nu / calm.S, brisk.nu * brisk.nu / brisk.S));
    if (!variance) {
      ++result.gated;
      continue;
    }
    calm.S += *variance - gate_.variance();
    brisk.S += *variance - gate_.variance();
    correct(track.calm, calm);
    correct(track.brisk, brisk);
    log_odds -= 0.5 * (calm.nu * calm.nu / calm.S - brisk.nu * brisk.nu / brisk.S +
                       std::log(calm.S / brisk.S));
    ++result.used;
  }
  coast(track, cycle_time_ - now);
  // Bayes, for the odds of calm against brisk.
  const double odds =
      track.calm_share / (1.0 - track.calm_share) * std::exp(std::clamp(log_odds, -50.0, 50.0));
  track.calm_share = std::clamp(odds / (1.0 + odds), 1e-6, 1.0 - 1e-6);
  return result;
}

bool DetectorTracker::before_projectors(const Eigen::Vector3d& p_W,
                                        std::span<const std::uint8_t> take) const noexcept {
  for (std::size_t p = 0; p < rig_.size(); ++p) {
    if (take[p] == 0) continue;
    if (!(rig_.projectors[p]->P.row(1).head<3>().dot(p_W) + 1.0 > kNearest)) return false;
  }
  return true;
}

bool DetectorTracker::begin(Track& track, std::size_t detector,
                            const ProjectorFrame& frame) noexcept {
  track = Track{};
  std::size_t n = 0;
  for (std::size_t p = 0; p < rig_.size(); ++p) {
    const std::uint8_t value = frame.value(detector, p);
    if (value == wire::kNoValue || !rig_.projectors[p]) continue;
    planes_[n] = rig_.projectors[p]->plane(value);
    slots_[n++] = p;
  }
  const auto solved = intersect_filtered(std::span(planes_).first(n), kBeginLimit,
                                         std::span(used_planes_).first(n));
  if (!solved) return false;
  std::fill(take_.begin(), take_.end(), std::uint8_t{0});
  for (std::size_t i = 0; i < n; ++i) take_[slots_[i]] = used_planes_[i];
  track.calm = track.brisk = MovingPoint::at(solved->p_W, kBeginSigma, options_.velocity_sigma,
                                             options_.acceleration_sigma);
  const CycleResult result = filter(track, detector, frame, take_);
  track.active = result.used >= static_cast<int>(kFewestPlanes) && result.gated < result.used &&
                 before_projectors(track.calm.p, take_);
  return track.active;
}

std::optional<MovingPoint> DetectorTracker::confirmed(std::size_t detector) const noexcept {
  const Track& track = tracks_[detector];
  if (!track.active || !track.fresh || track.agreed < kAgreeingCycles || track.strain.suspect()) {
    return std::nullopt;
  }
  return blend(track.calm, track.brisk, track.calm_share);
}

void DetectorTracker::give(const Track& track, std::size_t detector,
                           MarkerFrame& out) const noexcept {
  out.visible[detector] = 0;
  out.p_WM[detector].setZero();
  out.residual[detector] = 0.0F;
  if (!track.active || !track.fresh) return;
  const auto point = confirmed(detector);
  if (!point) return;
  const double variance = point->P_pp.trace();
  if (!(variance <= options_.visible_sigma * options_.visible_sigma)) return;
  out.visible[detector] = 1;
  out.p_WM[detector] = point->p;
  out.residual[detector] = static_cast<float>(std::sqrt(variance));
}

void DetectorTracker::update(Track& track, std::size_t detector,
                             const ProjectorFrame& frame) noexcept {
  if (!track.active) {
    begin(track, detector, frame);
    return;
  }
  mix(track);
  const Track before = track;
  const CycleResult result = filter(track, detector, frame, {});
  const bool young = track.agreed < kAgreeingCycles;
  const int least = young ? static_cast<int>(kFewestPlanes) : 1;
  track.strain.add(result.used, result.gated);
  const bool clean = kClean * result.gated <= result.used;
  const bool agreed = result.used >= least && result.gated <= result.used && (clean || !young);
  track.fresh = agreed && clean;
  if (agreed && !track.strain.broken()) {
    track.agreed = std::min(track.agreed + 1, kAgreeingCycles);
    return;
  }
  if (result.gated == 0 && !young) return;  // it sees nothing
  // Nothing of this cycle is used, for what passed the gate may have done so by chance.
  const Strain strain = track.strain;
  track = before;
  track.strain = strain;
  track.fresh = false;
  coast(track, cycle_time_);
  if (young || strain.broken()) {
    Track other;
    if (begin(other, detector, frame) || young) track = other;
  }
}

void DetectorTracker::update(const ProjectorFrame& frame, std::span<const std::uint8_t> skip,
                             MarkerFrame& out) noexcept {
  const std::size_t n = tracks_.size();
  if (out.p_WM.size() != n || out.visible.size() != n || out.residual.size() != n) {
    out = MarkerFrame(n);
  }
  if (cycle_ && (frame.cycle <= *cycle_ || frame.cycle - *cycle_ > kLongestGap)) {
    for (Track& track : tracks_) track.active = false;
    cycle_.reset();
  }
  const bool fits = frame.detectors == n && frame.projectors == rig_.size() &&
                    frame.values.size() == n * rig_.size();
  const std::uint64_t lost = (cycle_ ? frame.cycle - *cycle_ - 1 : 0) + (fits ? 0 : 1);
  cycle_ = frame.cycle;
  const double lost_variance = options_.lost_sigma * options_.lost_sigma;
  for (std::size_t d = 0; d < n; ++d) {
    Track& track = tracks_[d];
    if (!skip.empty() && skip[d] != 0) {
      track.active = false;
      continue;
    }
    for (std::uint64_t k = 0; track.active && k < lost; ++k) {
      mix(track);
      coast(track, cycle_time_);
      track.fresh = false;
    }
    if (fits) update(track, d, frame);
    if (track.active && !(track.brisk.P_pp.trace() <= lost_variance)) track.active = false;
    give(track, d, out);
  }
}

}  // namespace secondskin::server
