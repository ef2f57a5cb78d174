#pragma once

#include <time.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <numbers>
#include <string>
#include <vector>

#include "motion/kinematics.h"
#include "motion/retarget.h"
#include "motion/rotation.h"
#include "server/wearable/estimate/body_filter.h"
#include "sim/wearable/simulated_measurements.h"
#include "sim/wearable/worn_garment.h"

/// Runs of the wearable filter on a simulated garment, next to the truth: shared by benchmarks.
namespace secondskin::bench {

inline constexpr double deg(double radians) { return radians * 180.0 / std::numbers::pi; }

/// Processor time of this thread [s]: what other processes do does not count.
inline double cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

/// A motion made as long as wanted by playing it to and fro, cut there [s].
inline Motion stretched(const Motion& motion, double seconds) {
  Motion result{motion.skeleton, motion.rate_hz, {}};
  const auto wanted = static_cast<std::size_t>(seconds * motion.rate_hz) + 1;
  const auto last = static_cast<std::ptrdiff_t>(motion.poses.size()) - 1;
  for (std::ptrdiff_t i = 0, step = 1; result.poses.size() < wanted; i += step) {
    result.poses.push_back(motion.poses[static_cast<std::size_t>(i)]);
    if (i == last) step = -1;
    if (i == 0) step = 1;
  }
  return result;
}

/// A stretch of a walk, again and again, on the spot: the stretch of 0.9 to 2.5 s whose ends are
/// most alike, its end blended into what came before its beginning, without its advance.
inline Motion treadmill_walk(const Motion& walk, double seconds) {
  const auto frames = [&](double s) { return static_cast<std::size_t>(s * walk.rate_hz); };
  const std::size_t blend = frames(0.2);
  const auto apart = [&](std::size_t a, std::size_t b) {
    double sum = 0.0;
    for (std::size_t i = 1; i < walk.skeleton.size(); ++i) {
      sum += geodesic_distance(walk.poses[a].q_PB[i], walk.poses[b].q_PB[i]);
    }
    return sum;
  };
  std::size_t from = walk.poses.size() / 4, to = from + frames(0.9);
  double least = INFINITY;
  // The middle of the recording: people start and stop at its ends.
  for (std::size_t a = walk.poses.size() / 4; a < walk.poses.size(); a += 4) {
    for (std::size_t b = a + frames(0.9); b < a + frames(2.5); b += 2) {
      if (b >= walk.poses.size() * 3 / 4) break;
      const double way = (walk.poses[b].p_WR - walk.poses[a].p_WR).head<2>().norm();
      if (way < 0.5 * static_cast<double>(b - a) / walk.rate_hz) continue;  // stands
      const double d = apart(a, b) + apart(a + 4, b + 4);
      if (d < least) {
        least = d;
        from = a;
        to = b;
      }
    }
  }
  std::vector<Pose> round;
  Eigen::Vector3d advance = walk.poses[to].p_WR - walk.poses[from].p_WR;
  advance.z() = 0.0;
  const auto on_the_spot = [&](std::size_t i) {
    Pose pose = walk.poses[i];
    pose.p_WR -= advance * ((static_cast<double>(i) - static_cast<double>(from)) /
                            static_cast<double>(to - from));
    return pose;
  };
  for (std::size_t i = from; i < to; ++i) {
    Pose pose = on_the_spot(i);
    if (i + blend > to) {
      const Pose other = on_the_spot(i - (to - from));
      const double u = static_cast<double>(i + blend - to) / static_cast<double>(blend);
      Pose mixed = pose;
      interpolate(pose, other, u, mixed);
      pose = mixed;
    }
    round.push_back(pose);
  }
  Motion result{walk.skeleton, walk.rate_hz, {}};
  const std::size_t wanted = frames(seconds) + 1;
  while (result.poses.size() < wanted)
    result.poses.push_back(round[result.poses.size() % round.size()]);
  return result;
}

/// The simple start: the pose of rest is known; gyroscopes are zeroed and boards are turned until
/// what they feel points up. Section 5.4 has more, and server/wearable/start.
struct RestStart {
  std::vector<Eigen::Isometry3d> X_BS;
  std::vector<server::BoardBias> biases;

  RestStart(const Skeleton& assumed, const Garment& garment, const Pose& pose)
      : boards_(garment.boards), R_WB_(kJointCount) {
    std::vector<Eigen::Isometry3d> X_WB(kJointCount);
    forward_kinematics(assumed, pose.p_WR, pose.q_PB, X_WB);
    for (std::size_t i = 0; i < kJointCount; ++i) R_WB_[i] = X_WB[i].linear();
    for (const SensorBoard& board : boards_) X_BS.push_back(board_place(assumed, board));
    biases.resize(boards_.size());
    accel_.resize(boards_.size(), Eigen::Vector3d::Zero());
    count_.resize(boards_.size(), 0.0);
  }
  void add(const server::Measurement& m) {
    if (m.kind != server::MeasurementKind::kInertial) return;
    for (std::size_t b = 0; b < boards_.size(); ++b) {
      if (!m.boards[b].gyro_valid || !m.boards[b].accel_valid) continue;
      biases[b].gyro += m.boards[b].gyro;
      accel_[b] += m.boards[b].accel;
      count_[b] += 1.0;
    }
  }
  void finish() {
    for (std::size_t b = 0; b < boards_.size(); ++b) {
      if (count_[b] == 0.0) continue;
      biases[b].gyro /= count_[b];
      biases[b].gyro_sigma = 0.001;
      biases[b].accel_sigma = 0.05;
      const Eigen::Vector3d up_B =
          R_WB_[index(boards_[b].segment)].transpose() * Eigen::Vector3d::UnitZ();
      const Eigen::Vector3d felt_B = X_BS[b].linear() * accel_[b];
      X_BS[b].linear() =
          Eigen::Quaterniond::FromTwoVectors(felt_B, up_B).toRotationMatrix() * X_BS[b].linear();
    }
  }

 private:
  std::vector<SensorBoard> boards_;
  std::vector<Eigen::Matrix3d> R_WB_;
  std::vector<Eigen::Vector3d> accel_;
  std::vector<double> count_;
};

/// A run's options beside the filter's.
struct RunOptions {
  double root_sigma_p = 0.002, root_sigma_q = 0.002;  ///< of the given root [m], [rad]
  std::uint64_t seed = 1;
  sim::MeasurementOptions measurements;
};

/// What a visitor is told at each inertial sample after the rest.
struct Moment {
  double time;  ///< since the motion began [s]
  const server::BodyFilter& filter;
  const Pose& truth;
};

struct RunCost {
  double filter_seconds = 0.0;  ///< processor time
  double body_seconds = 0.0;    ///< of the motion
  std::vector<double> latency;  ///< processor time a measurement [s]
};

/// Rest, start, then the whole motion with the root given.
inline RunCost run(const sim::WornGarment& worn, const server::FilterSettings& settings,
                   const RunOptions& options, const std::function<void(const Moment&)>& visit) {
  sim::SimulatedMeasurements stream(worn, options.seed + 1000, options.measurements);
  server::Measurement m;
  Pose truth(kJointCount);
  worn.pose_at(0.0, truth);
  RestStart start(worn.assumed_skeleton(), worn.garment(), truth);
  const double begin = worn.rest() - 0.1;
  while (stream.next(m) == server::Next::kPose && stream.time_of(m.stamp_ns) < begin) start.add(m);
  start.finish();
  server::BodyFilter filter(worn.assumed_skeleton(), worn.garment(), start.X_BS, settings);
  filter.start(truth, m.stamp_ns, start.biases);
  RunCost cost;
  do {
    const double time = stream.time_of(m.stamp_ns);
    const bool inertial = m.kind == server::MeasurementKind::kInertial;
    if (inertial) worn.pose_at(time, truth);
    const double before = cpu_time();
    if (inertial) {
      Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
      X_WR.linear() = truth.q_PB[0].toRotationMatrix();
      X_WR.translation() = truth.p_WR;
      filter.observe_root(m.stamp_ns, X_WR, options.root_sigma_p, options.root_sigma_q);
    }
    filter.process(m);
    cost.latency.push_back(cpu_time() - before);
    cost.filter_seconds += cost.latency.back();
    if (inertial && time >= worn.rest()) visit({time - worn.rest(), filter, truth});
  } while (stream.next(m) == server::Next::kPose);
  cost.body_seconds = worn.duration() - begin;
  return cost;
}

/// Orientation of a segment relative to the root [rad]: how far apart two poses are in it.
inline double error_under_root(const Skeleton& skeleton, const Pose& a, const Pose& b,
                               Joint joint) {
  const auto under_root = [&](const Pose& pose) {
    Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
    for (std::size_t i = index(joint); i != 0; i = *skeleton[i].parent) q = pose.q_PB[i] * q;
    return q;
  };
  return geodesic_distance(under_root(a), under_root(b));
}

}  // namespace secondskin::bench
