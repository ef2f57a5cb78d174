#include "server/optical/calibrate/value_sync.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <stdexcept>

#include "wire/photo_tag.h"

namespace secondskin::server {
namespace {

constexpr std::size_t kWindow = 2 * ValueSync::kReach + 1;
constexpr std::size_t kLeast = 5;      // values in a window
constexpr double kTolerance = 2.5;     // a value further from the parabola is wild [counts]
constexpr std::uint64_t kMostGap = 2;  // cycles lost within a window

struct Sample {
  double t;  // from the instant, in cycles
  double v;
};

// a + b t + c t^2 through the samples of `use`.
std::optional<Eigen::Vector3d> parabola(const std::array<Sample, kWindow>& samples, std::size_t n,
                                        unsigned use) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < n; ++k) {
    if ((use >> k & 1U) == 0) continue;
    const Eigen::Vector3d row(1.0, samples[k].t, samples[k].t * samples[k].t);
    A += row * row.transpose();
    b += row * samples[k].v;
  }
  const Eigen::Matrix3d inverse = A.inverse();
  if (!inverse.allFinite()) return std::nullopt;
  return inverse * b;
}

double error(const Eigen::Vector3d& fit, const Sample& s) {
  return std::fabs(fit[0] + s.t * (fit[1] + s.t * fit[2]) - s.v);
}

// The samples near the parabola through three of them that has most samples near.
unsigned consensus(const std::array<Sample, kWindow>& samples, std::size_t n) {
  unsigned best = 0;
  int most = 0;
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = i + 1; j < n; ++j) {
      for (std::size_t k = j + 1; k < n; ++k) {
        const auto fit = parabola(samples, n, 1U << i | 1U << j | 1U << k);
        if (!fit) continue;
        unsigned near = 0;
        int count = 0;
        for (std::size_t l = 0; l < n; ++l) {
          if (error(*fit, samples[l]) > kTolerance) continue;
          near |= 1U << l;
          ++count;
        }
        if (count > most) {
          most = count;
          best = near;
        }
      }
    }
  }
  return best;
}

std::optional<double> at_instant(const std::array<Sample, kWindow>& samples, std::size_t n) {
  unsigned use = (1U << n) - 1U;
  for (int pass = 0; pass < 2; ++pass) {
    int before = 0, after = 0;
    for (std::size_t k = 0; k < n; ++k) {
      if ((use >> k & 1U) == 0) continue;
      ++(samples[k].t < 0.0 ? before : after);
    }
    if (before + after < static_cast<int>(kLeast) || before < 2 || after < 2) return std::nullopt;
    const auto fit = parabola(samples, n, use);
    if (!fit) return std::nullopt;
    bool fits = true;
    for (std::size_t k = 0; k < n; ++k) {
      if ((use >> k & 1U) != 0 && error(*fit, samples[k]) > kTolerance) fits = false;
    }
    if (fits) return (*fit)[0];
    use = consensus(samples, n);
  }
  return std::nullopt;
}

}  // namespace

std::optional<SyncedFrame> ValueSync::add(const ProjectorFrame& frame) {
  if (frame.detectors != detectors_ || frame.projectors != projectors_ ||
      frame.values.size() != detectors_ * projectors_) {
    throw std::invalid_argument(
        fmt::format("frame {} has {} detectors and {} projectors; expected {} and {}", frame.cycle,
                    frame.detectors, frame.projectors, detectors_, projectors_));
  }
  if (!frames_.empty() &&
      (frame.stamp_ns <= frames_.back().stamp_ns || frame.cycle <= frames_.back().cycle)) {
    return std::nullopt;
  }
  frames_.push_back(frame);
  if (frames_.size() > kWindow) frames_.pop_front();
  if (frames_.size() < kWindow ||
      frames_.back().cycle - frames_.front().cycle > kWindow - 1 + kMostGap) {
    return std::nullopt;
  }

  const auto cycle = static_cast<double>(wire::cycle_ns(projectors_));
  const ProjectorFrame& middle = frames_[kReach];
  SyncedFrame out;
  out.cycle = middle.cycle;
  out.stamp_ns = middle.stamp_ns + wire::cycle_ns(projectors_) / 2;
  out.detectors = detectors_;
  out.projectors = projectors_;
  out.values.assign(middle.values.size(), std::numeric_limits<float>::quiet_NaN());
  for (std::size_t d = 0; d < detectors_; ++d) {
    for (std::size_t p = 0; p < projectors_; ++p) {
      std::array<Sample, kWindow> samples{};
      std::size_t n = 0;
      for (const ProjectorFrame& f : frames_) {
        const std::uint8_t v = f.value(d, p);
        // The first and the last value also stand for what lies beyond them.
        if (v <= 1 || v >= 254) continue;
        const std::int64_t t = f.stamp_ns + wire::value_time_ns(p) - out.stamp_ns;
        samples[n++] = {static_cast<double>(t) / cycle, static_cast<double>(v)};
      }
      if (const auto v = at_instant(samples, n)) {
        out.values[d * projectors_ + p] = static_cast<float>(*v);
      }
    }
  }
  return out;
}

}  // namespace secondskin::server
