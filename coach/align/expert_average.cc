#include "coach/align/expert_average.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>

#include "motion/rotation.h"

namespace secondskin::coach {
namespace {

constexpr int kRounds = 5;             // of averaging; the mean moves by less than 0.1 deg after 3
constexpr double kSmoothing = 0.1;     // half width of the running means [s]
constexpr double kVelocityTime = 0.1;  // 1 rad/s of wrong velocity is like 0.1 rad [s]
constexpr double kVelocityStep = 0.033;  // half of the time that velocities are taken over [s]

constexpr std::size_t kRoot = index(Joint::kPelvis);

Eigen::Vector3d up_in(const Eigen::Quaterniond& q_WB) {
  return q_WB.conjugate() * Eigen::Vector3d::UnitZ();
}

// The same orientation turned about the vertical so that it faces as `like` does.
Eigen::Quaterniond facing_as(const Eigen::Quaterniond& like, const Eigen::Quaterniond& q_WB) {
  const double heading = twist_angle(like * q_WB.conjugate(), Eigen::Vector3d::UnitZ());
  return Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ()) * q_WB;
}

// Centred running mean, cut at the ends evenly so that it keeps straight lines and the ends.
template <class Get, class Set>
void smooth(std::size_t n, std::size_t half, Get get, Set set) {
  std::vector<double> sums(n + 1, 0.0);
  for (std::size_t i = 0; i < n; ++i) sums[i + 1] = sums[i] + get(i);
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t h = std::min({half, i, n - 1 - i});
    set(i, (sums[i + h + 1] - sums[i - h]) / static_cast<double>(2 * h + 1));
  }
}

std::size_t half_width(double rate_hz) {
  return static_cast<std::size_t>(std::lround(kSmoothing * rate_hz));
}

// What the warping compares: rotations and velocities of the joints that count.
struct Track {
  std::vector<std::array<Eigen::Quaterniond, kJointCount>> q;
  std::vector<std::array<Eigen::Vector3d, kJointCount>> v;
};

Track track_of(const Motion& motion) {
  const auto n = static_cast<std::ptrdiff_t>(motion.poses.size());
  const auto step = std::max<std::ptrdiff_t>(1, std::lround(kVelocityStep * motion.rate_hz));
  Track track{std::vector<std::array<Eigen::Quaterniond, kJointCount>>(motion.poses.size()),
              std::vector<std::array<Eigen::Vector3d, kJointCount>>(motion.poses.size())};
  for (std::ptrdiff_t i = 0; i < n; ++i) {
    const auto& before =
        motion.poses[static_cast<std::size_t>(std::max<std::ptrdiff_t>(i - step, 0))];
    const auto& after =
        motion.poses[static_cast<std::size_t>(std::min<std::ptrdiff_t>(i + step, n - 1))];
    const double seconds = 2.0 * static_cast<double>(step) / motion.rate_hz;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const auto k = static_cast<std::size_t>(i);
      track.q[k][j] = motion.poses[k].q_PB[j];
      track.v[k][j] = rotation_vector(before.q_PB[j].conjugate() * after.q_PB[j]) / seconds;
    }
  }
  return track;
}

double distance_square(const Motion& a, const Track& ta, std::size_t i, const Motion& b,
                       const Track& tb, std::size_t k,
                       const std::array<double, kJointCount>& weight) {
  double sum = 0.0, weights = 0.0;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (weight[j] <= 0.0 || a.poses[i].confidence[j] <= 0.0F || b.poses[k].confidence[j] <= 0.0F) {
      continue;
    }
    weights += weight[j];
    if (j == kRoot) {
      sum += weight[j] * (up_in(ta.q[i][j]) - up_in(tb.q[k][j])).squaredNorm();
    } else {
      const double angle = geodesic_distance(ta.q[i][j], tb.q[k][j]);
      sum += weight[j] * (angle * angle +
                          kVelocityTime * kVelocityTime * (ta.v[i][j] - tb.v[k][j]).squaredNorm());
    }
  }
  return weights > 0.0 ? sum / weights : 0.0;
}

// Karcher mean: the orientation from which the rotation vectors to all others sum to nothing.
Eigen::Quaterniond mean_of(std::span<const Eigen::Quaterniond> q) {
  Eigen::Quaterniond mean = q.front();
  for (int round = 0; round < 20; ++round) {
    Eigen::Vector3d step = Eigen::Vector3d::Zero();
    for (const auto& each : q) step += rotation_vector(mean.conjugate() * each);
    step /= static_cast<double>(q.size());
    mean = (mean * quaternion_from(step)).normalized();
    if (step.norm() < 1e-9) break;
  }
  return mean;
}

// The mean pose of those that belong together, and how far they are from it.
void average(std::span<const Pose> poses, Pose& mean, std::array<double, kJointCount>& spread) {
  std::vector<Eigen::Quaterniond> q;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    q.clear();
    float confidence = 0.0F;
    for (const Pose& pose : poses) {
      if (pose.confidence[j] <= 0.0F) continue;
      q.push_back(j == kRoot && !q.empty() ? facing_as(q.front(), pose.q_PB[j]) : pose.q_PB[j]);
      confidence = std::max(confidence, pose.confidence[j]);
    }
    spread[j] = 0.0;
    mean.confidence[j] = confidence;
    mean.q_PB[j] = poses.front().q_PB[j];
    if (q.empty()) continue;
    mean.q_PB[j] = mean_of(q);
    if (j == kRoot) mean.q_PB[j] = facing_as(q.front(), mean.q_PB[j]);
    if (q.size() < 2) continue;
    for (const auto& each : q) {
      const double angle =
          j == kRoot ? std::acos(std::clamp(up_in(each).dot(up_in(mean.q_PB[j])), -1.0, 1.0))
                     : geodesic_distance(each, mean.q_PB[j]);
      spread[j] += angle * angle;
    }
    spread[j] = std::sqrt(spread[j] / static_cast<double>(q.size() - 1));
  }
}

}  // namespace

std::vector<double> warp_onto(const Motion& a, const Motion& b,
                              const std::array<double, kJointCount>& weight) {
  const std::size_t rows = a.poses.size(), columns = b.poses.size();
  const Track ta = track_of(a), tb = track_of(b);
  enum Step : std::uint8_t { kDiagonal, kRow, kColumn };
  std::vector<Step> step(rows * columns, kDiagonal);
  std::vector<double> cost(columns), above(columns);
  constexpr double kFar = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < rows; ++i) {
    above.swap(cost);
    for (std::size_t k = 0; k < columns; ++k) {
      const double d = distance_square(a, ta, i, b, tb, k, weight);
      // Both together count double, or longer paths would cost more (Sakoe & Chiba 1978, P = 0).
      const double diagonal = i > 0 && k > 0 ? above[k - 1] + 2.0 * d : i + k == 0 ? d : kFar;
      const double row = i > 0 ? above[k] + d : kFar;
      const double column = k > 0 ? cost[k - 1] + d : kFar;
      cost[k] = std::min({diagonal, row, column});
      step[i * columns + k] = cost[k] == diagonal ? kDiagonal : cost[k] == row ? kRow : kColumn;
    }
  }
  std::vector<double> sum(rows, 0.0), count(rows, 0.0), path(rows);
  for (std::size_t i = rows - 1, k = columns - 1;;) {
    sum[i] += static_cast<double>(k);
    count[i] += 1.0;
    if (i == 0 && k == 0) break;
    const Step s = step[i * columns + k];
    if (s != kColumn) --i;
    if (s != kRow) --k;
  }
  sum.front() = 0.0;  // ends belong to ends
  count.front() = 1.0;
  sum.back() = static_cast<double>(columns - 1);
  count.back() = 1.0;
  smooth(
      rows, half_width(a.rate_hz), [&](std::size_t i) { return sum[i] / count[i]; },
      [&](std::size_t i, double x) { path[i] = x; });
  return path;
}

ExpertAverage average_experts(std::span<const Motion> experts,
                              const std::array<double, kJointCount>& weight, double rate_hz) {
  if (experts.empty()) throw std::invalid_argument("average of experts: there is none");
  for (const Motion& expert : experts) {
    if (!is_canonical(expert.skeleton) || expert.poses.empty()) {
      throw std::invalid_argument("average of experts: one is not on the canonical skeleton");
    }
  }
  std::vector<Motion> performances;
  for (const Motion& expert : experts) performances.push_back(resample(expert, rate_hz));
  ExpertAverage result{performances.front(), {}};
  result.spread.assign(result.motion.poses.size(), {});
  if (performances.size() == 1) return result;

  // Each round: every performance is warped onto the mean so far, then the mean is taken anew. Its
  // time axis is the first expert's until the last round.
  std::vector<std::vector<double>> paths(performances.size());
  std::vector<Pose> together(performances.size(), Pose(kJointCount));
  for (int round = 0; round < kRounds; ++round) {
    for (std::size_t e = 0; e < performances.size(); ++e) {
      paths[e] = warp_onto(result.motion, performances[e], weight);
    }
    for (std::size_t i = 0; i < result.motion.poses.size(); ++i) {
      for (std::size_t e = 0; e < performances.size(); ++e) {
        sample(performances[e], paths[e][i] / rate_hz, together[e]);
      }
      Pose& mean = result.motion.poses[i];
      average(together, mean, result.spread[i]);
      mean.p_WR = together.front().p_WR;
    }
  }
  for (std::size_t j = 0; j < kJointCount; ++j) {
    smooth(
        result.spread.size(), half_width(rate_hz),
        [&](std::size_t i) { return result.spread[i][j]; },
        [&](std::size_t i, double x) { result.spread[i][j] = x; });
  }

  // The mean timing: frame i belongs at the mean of the times at which the experts were there.
  const std::size_t n = result.motion.poses.size();
  std::vector<double> when(n, 0.0);
  for (std::size_t i = 0; i < n; ++i) {
    for (const auto& path : paths) when[i] += path[i] / static_cast<double>(paths.size());
  }
  const auto length = static_cast<std::size_t>(std::lround(when.back())) + 1;
  Motion timed = result.motion;
  timed.poses.assign(length, Pose(kJointCount));
  std::vector<std::array<double, kJointCount>> spread(length);
  for (std::size_t k = 0; k < length; ++k) {
    const auto t = static_cast<double>(k);
    const auto after = static_cast<std::size_t>(
        std::clamp<std::ptrdiff_t>(std::lower_bound(when.begin(), when.end(), t) - when.begin(), 1,
                                   static_cast<std::ptrdiff_t>(n) - 1));
    const double from = when[after - 1], to = when[after];
    const double u = to > from ? std::clamp((t - from) / (to - from), 0.0, 1.0) : 0.0;
    interpolate(result.motion.poses[after - 1], result.motion.poses[after], u, timed.poses[k]);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      spread[k][j] = (1.0 - u) * result.spread[after - 1][j] + u * result.spread[after][j];
    }
  }
  return {std::move(timed), std::move(spread)};
}

}  // namespace secondskin::coach
