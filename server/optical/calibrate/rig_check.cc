#include "server/optical/calibrate/rig_check.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <stdexcept>

#include "server/optical/calibrate/triangulation.h"

namespace secondskin::server {
namespace {

constexpr std::size_t kMostFrames = 400;
constexpr std::size_t kLeastSightings = 30;
constexpr double kGoodShare = 0.8;      // of a good projector's values fit
constexpr double kGoodDistance = 0.01;  // [m]

struct Place {
  std::size_t frame;
  std::size_t detector;
  Eigen::Vector3d p_W;
  const std::vector<Sighting>* sightings;
};

struct Fit {
  std::size_t sightings = 0;
  double share = 0.0;     // within kFits
  double residual = 0.0;  // median [counts]
};

double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// How the values of a slot fit a projector at the places.
Fit fit_of(const std::vector<Place>& places, std::size_t slot, const Projector& projector) {
  std::vector<double> residuals;
  std::size_t fitting = 0;
  for (const Place& place : places) {
    for (const Sighting& s : *place.sightings) {
      if (s.projector != slot) continue;
      residuals.push_back(std::fabs(projector.value(place.p_W) - s.value));
      if (residuals.back() <= kFits) ++fitting;
    }
  }
  Fit fit;
  fit.sightings = residuals.size();
  if (residuals.empty()) return fit;
  fit.share = static_cast<double>(fitting) / static_cast<double>(residuals.size());
  fit.residual = median(residuals);
  return fit;
}

std::string list(const std::vector<std::size_t>& slots) {
  std::string out;
  for (std::size_t k = 0; k < slots.size(); ++k) {
    out += fmt::format("{}{}", k == 0 ? "" : k + 1 == slots.size() ? " and " : ", ", slots[k]);
  }
  return out;
}

}  // namespace

RigCheck::RigCheck(ProjectorRig rig, std::size_t detectors, std::vector<KnownDistance> distances)
    : rig_(std::move(rig)),
      detectors_(detectors),
      distances_(std::move(distances)),
      sync_(detectors, rig_.size()) {
  for (const KnownDistance& d : distances_) {
    if (d.a >= detectors || d.b >= detectors || d.a == d.b || !(d.distance > 0.0)) {
      throw std::invalid_argument(fmt::format(
          "a known distance of {} m between detectors {} and {}; expected a positive one between "
          "two of {} detectors",
          d.distance, d.a, d.b, detectors));
    }
  }
}

void RigCheck::add(const ProjectorFrame& frame) {
  auto synced = sync_.add(frame);
  if (!synced || count_++ % stride_ != 0) return;
  frames_.push_back(std::move(*synced));
  if (frames_.size() < kMostFrames) return;
  // Half of them, evenly; from now on half as often.
  for (std::size_t k = 0; 2 * k < frames_.size(); ++k) {
    if (k > 0) frames_[k] = std::move(frames_[2 * k]);
  }
  frames_.resize((frames_.size() + 1) / 2);
  stride_ *= 2;
}

std::optional<RigReport> RigCheck::report() const {
  std::vector<std::vector<Sighting>> sightings;
  for (const SyncedFrame& frame : frames_) {
    for (std::size_t d = 0; d < detectors_; ++d) {
      auto& of = sightings.emplace_back();
      for (std::size_t p = 0; p < frame.projectors; ++p) {
        if (const auto v = frame.value(d, p)) of.push_back({p, *v});
      }
    }
  }
  // Places by the projectors that are trusted; the worst one loses its trust until all agree.
  ProjectorRig trusted = rig_;
  std::vector<Place> places;
  std::vector<std::size_t> suspects;
  for (;;) {
    places.clear();
    std::vector<std::size_t> seen(rig_.size(), 0), apart(rig_.size(), 0);
    for (std::size_t k = 0; k < sightings.size(); ++k) {
      if (const auto found = triangulate(trusted, sightings[k])) {
        places.push_back({k / detectors_, k % detectors_, found->p_W, &sightings[k]});
        for (const Sighting& s : sightings[k]) {
          if (!trusted.projectors[s.projector]) continue;
          ++seen[s.projector];
          const double r = trusted.projectors[s.projector]->value(found->p_W) - s.value;
          if (std::fabs(r) > kFits) ++apart[s.projector];
        }
      } else {
        // No agreement: whoever is part of it is under suspicion.
        std::size_t n = 0;
        for (const Sighting& s : sightings[k]) n += trusted.projectors[s.projector] ? 1 : 0;
        if (n < 5) continue;
        for (const Sighting& s : sightings[k]) {
          ++seen[s.projector];
          ++apart[s.projector];
        }
      }
    }
    std::optional<std::size_t> worst;
    double most = 1.0 - kGoodShare;
    for (std::size_t i = 0; i < rig_.size(); ++i) {
      if (!trusted.projectors[i] || seen[i] < kLeastSightings) continue;
      const double share = static_cast<double>(apart[i]) / static_cast<double>(seen[i]);
      if (share > most) {
        most = share;
        worst = i;
      }
    }
    if (!worst) break;
    trusted.projectors[*worst].reset();
    suspects.push_back(*worst);
  }
  if (places.size() < kLeastPlaces) return std::nullopt;

  RigReport report;
  report.projectors.resize(rig_.size());
  std::vector<std::size_t> moved, exchanged;
  for (std::size_t i = 0; i < rig_.size(); ++i) {
    CheckedProjector& checked = report.projectors[i];
    if (!rig_.projectors[i]) {
      checked.state = ProjectorState::kUncalibrated;
      continue;
    }
    const Fit own = fit_of(places, i, *rig_.projectors[i]);
    checked.sightings = own.sightings;
    checked.residual = own.residual;
    if (own.sightings < kLeastSightings) continue;
    if (own.share >= kGoodShare) {
      checked.state = ProjectorState::kGood;
      continue;
    }
    checked.state = ProjectorState::kMoved;
    for (std::size_t j = 0; j < rig_.size(); ++j) {
      if (j == i || !rig_.projectors[j]) continue;
      if (fit_of(places, i, *rig_.projectors[j]).share >= kGoodShare) {
        checked.state = ProjectorState::kExchanged;
        checked.slot = j;
      }
    }
    (checked.state == ProjectorState::kMoved ? moved : exchanged).push_back(i);
  }
  if (!exchanged.empty()) {
    report.findings.push_back(fmt::format(
        "projectors {} seem to be exchanged: each fits the place of another one", list(exchanged)));
  }
  for (const std::size_t i : moved) {
    report.findings.push_back(
        fmt::format("projector {} seems to have moved: its values are off by {:.1f} counts in the "
                    "middle (median); calibrate again",
                    i, report.projectors[i].residual));
  }

  // Detectors: the distances between the places that their values give.
  if (distances_.empty()) return report;
  std::map<std::size_t, std::vector<const Place*>> by_frame;
  for (const Place& place : places) by_frame[place.frame].push_back(&place);
  const std::size_t n = detectors_;
  std::vector<std::vector<double>> measured(n * n);
  for (const auto& [frame, of_frame] : by_frame) {
    for (const Place* p : of_frame) {
      for (const Place* q : of_frame) {
        if (p->detector != q->detector) {
          measured[p->detector * n + q->detector].push_back((p->p_W - q->p_W).norm());
        }
      }
    }
  }
  std::vector<double> medians(n * n, -1.0);
  for (std::size_t k = 0; k < medians.size(); ++k) {
    if (measured[k].size() >= kLeastSightings / 2) medians[k] = median(measured[k]);
  }
  std::vector<std::size_t> order(n);
  std::iota(order.begin(), order.end(), 0U);
  // Sum of the distances' errors, each at most 0.1 m: one wrong one is not worse than two.
  const auto cost = [&] {
    double sum = 0.0;
    for (const KnownDistance& d : distances_) {
      const double m = medians[order[d.a] * n + order[d.b]];
      if (m >= 0.0) sum += std::min(0.1, std::fabs(m - d.distance));
    }
    return sum;
  };
  double now = cost();
  while (now > kGoodDistance * 0.5 * static_cast<double>(distances_.size()) &&
         report.exchanged_detectors.size() < n / 2) {
    double best = now;
    std::pair<std::size_t, std::size_t> pair;
    for (std::size_t a = 0; a < n; ++a) {
      for (std::size_t b = a + 1; b < n; ++b) {
        std::swap(order[a], order[b]);
        if (const double c = cost(); c < best) {
          best = c;
          pair = {a, b};
        }
        std::swap(order[a], order[b]);
      }
    }
    if (best > now - 2.0 * kGoodDistance) break;
    std::swap(order[pair.first], order[pair.second]);
    report.exchanged_detectors.push_back(pair);
    now = best;
  }
  double square = 0.0;
  std::size_t known = 0;
  for (const KnownDistance& d : distances_) {
    const double m = medians[d.a * n + d.b];
    if (m < 0.0) continue;
    square += (m - d.distance) * (m - d.distance);
    ++known;
  }
  report.distance_rms = known > 0 ? std::sqrt(square / static_cast<double>(known)) : 0.0;
  for (const auto& [a, b] : report.exchanged_detectors) {
    report.findings.push_back(fmt::format(
        "detectors {} and {} seem to be exchanged: in each other's place their distances fit", a,
        b));
  }
  return report;
}

}  // namespace secondskin::server
