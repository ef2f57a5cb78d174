#include "motion/motion.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace secondskin {

void interpolate(const Pose& a, const Pose& b, double u, Pose& out) noexcept {
  out.p_WR = (1.0 - u) * a.p_WR + u * b.p_WR;
  const std::size_t joints = std::min({a.q_PB.size(), b.q_PB.size(), out.q_PB.size()});
  for (std::size_t i = 0; i < joints; ++i) out.q_PB[i] = a.q_PB[i].slerp(u, b.q_PB[i]).normalized();
  const std::size_t marks =
      std::min({a.confidence.size(), b.confidence.size(), out.confidence.size()});
  for (std::size_t i = 0; i < marks; ++i) {
    out.confidence[i] = std::min(a.confidence[i], b.confidence[i]);
  }
}

void sample(const Motion& motion, double time, Pose& out) {
  const std::size_t joints = motion.skeleton.size();
  if (out.q_PB.size() != joints) out.q_PB.resize(joints, Eigen::Quaterniond::Identity());
  if (out.confidence.size() != joints) out.confidence.resize(joints);
  const double last = static_cast<double>(motion.poses.size() - 1);
  // Written so that a NaN time is held at the start.
  const double at = time > 0.0 ? std::min(time * motion.rate_hz, last) : 0.0;
  const auto i = static_cast<std::size_t>(at);
  const std::size_t next = std::min(i + 1, motion.poses.size() - 1);
  interpolate(motion.poses[i], motion.poses[next], at - static_cast<double>(i), out);
}

Motion resample(const Motion& motion, double rate_hz) {
  if (!std::isfinite(rate_hz) || rate_hz <= 0.0) {
    throw std::invalid_argument(
        fmt::format("resample: rate {} Hz, expected a finite rate above 0", rate_hz));
  }
  // The tolerance keeps the last pose when duration * rate is a whole number but for rounding.
  const double steps = std::floor(motion.duration() * rate_hz + 1e-6);
  if (steps > 1e9) {
    throw std::invalid_argument(fmt::format("resample: {} Hz would make {} poses", rate_hz, steps));
  }
  Motion result{motion.skeleton, rate_hz, {}};
  result.poses.resize(static_cast<std::size_t>(steps) + 1);
  for (std::size_t i = 0; i < result.poses.size(); ++i) {
    sample(motion, static_cast<double>(i) / rate_hz, result.poses[i]);
  }
  return result;
}

Motion evenly(const Skeleton& skeleton, double rate_hz, std::span<const StampedPose> poses) {
  if (!(std::isfinite(rate_hz) && rate_hz > 0.0)) {
    throw std::invalid_argument("evenly: expected a rate above 0");
  }
  std::vector<const StampedPose*> kept;
  for (const StampedPose& pose : poses) {
    const bool later = kept.empty() || pose.stamp_ns > kept.back()->stamp_ns;
    if (later && pose.pose.is_valid()) kept.push_back(&pose);
  }
  if (kept.empty()) throw std::invalid_argument("evenly: expected a valid pose");
  Motion motion{skeleton, rate_hz, {}};
  const double step_ns = 1e9 / rate_hz;
  const auto stamp = [&](std::size_t k) {
    return static_cast<double>(kept[k]->stamp_ns - kept.front()->stamp_ns);
  };
  const double end = stamp(kept.size() - 1);
  std::size_t i = 0;
  Pose at(skeleton.size());
  for (double t = 0.0; t <= end + 0.5 * step_ns; t += step_ns) {
    while (i + 1 < kept.size() && stamp(i + 1) <= t) ++i;
    if (i + 1 < kept.size()) {
      interpolate(kept[i]->pose, kept[i + 1]->pose, (t - stamp(i)) / (stamp(i + 1) - stamp(i)), at);
      motion.poses.push_back(at);
    } else {
      motion.poses.push_back(kept[i]->pose);
    }
  }
  return motion;
}

Motion slice(const Motion& motion, std::size_t begin, std::size_t end) {
  if (begin >= end || end > motion.poses.size()) {
    throw std::out_of_range(
        fmt::format("slice: poses [{}, {}) of {}", begin, end, motion.poses.size()));
  }
  const auto first = motion.poses.begin();
  return {motion.skeleton, motion.rate_hz,
          std::vector<Pose>(first + static_cast<std::ptrdiff_t>(begin),
                            first + static_cast<std::ptrdiff_t>(end))};
}

}  // namespace secondskin
