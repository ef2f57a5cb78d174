#pragma once

#include <Eigen/Eigenvalues>
#include <cmath>

#include "server/wearable/estimate/body_filter.h"
#include "tests/wearable/drawn_body.h"

/// Monte Carlo runs of the wearable filter on motion, offsets and noise that are drawn from its own
/// model, for tests of consistency.
namespace secondskin::server {

struct ModelResult {
  double nees = 0.0;        ///< normalised square of the whole state's error at the end
  double joint_nees = 0.0;  ///< of the joints' rotations alone
  double least_eigenvalue = 0.0;
  InnovationFit gyro, accel, distance;
};

class ModelRun {
 public:
  const Skeleton skeleton = canonical_skeleton();
  const Garment garment = practical_garment();
  FilterSettings settings;
  double true_noise_scale = 1.0;  ///< of the sensors' noise, over the model's

  ModelRun() : filter_(skeleton, garment, places(skeleton, garment), quiet()) {
    settings = quiet();
  }
  const BodyLayout& layout() const { return filter_.layout(); }

  /// @param time  [s]
  ModelResult run(std::uint64_t seed, double time) {
    const BodyModel body(skeleton, garment, places(skeleton, garment));
    const BodyLayout& layout = body.layout;
    const auto n = layout.size();
    Draw draw(seed);
    filter_ = BodyFilter(skeleton, garment, places(skeleton, garment), settings);
    filter_.start(Pose(kJointCount), 0, {});
    const Eigen::MatrixXd P0 = dense(filter_.covariance(), n);
    Eigen::VectorXd error = draw.error(P0.llt().matrixL());
    BodyState truth = filter_.estimate();
    const auto span = [&](Eigen::VectorXd& v) {
      return std::span<double>(v.data(), static_cast<std::size_t>(n));
    };
    correct(layout, span(error), truth);

    const double dt = 1.0 / garment.inertial_rate_hz;
    const Eigen::MatrixXd driven = noise_factor(layout, dt);
    Measurement inertial, distances;
    inertial.kind = MeasurementKind::kInertial;
    inertial.boards.resize(garment.boards.size());
    distances.kind = MeasurementKind::kDistances;
    distances.distances.resize(garment.boards.size());
    ObservationSet ideal(layout, 64);
    const auto noise = [&](double sigma) { return draw.vector(true_noise_scale * sigma); };
    for (int step = 1; step * dt <= time; ++step) {
      propagate(truth, dt);
      error = draw.error(driven);
      correct(layout, span(error), truth);
      const auto stamp = static_cast<std::int64_t>(std::llround(1e9 * step * dt));
      inertial.stamp_ns = stamp;
      for (std::size_t b = 0; b < garment.boards.size(); ++b) {
        // An innovation for a reading of zero is what the truth predicts, reversed.
        const auto predicted = [&] {
          return Eigen::Vector3d(-ideal.y[0], -ideal.y[1], -ideal.y[2]);
        };
        ideal.clear();
        observe_gyro(body, truth, b, 0.0, Eigen::Vector3d::Zero(), 1.0, 0.0, ideal);
        inertial.boards[b].gyro = predicted() + noise(settings.gyro_noise);
        inertial.boards[b].gyro_valid = true;
        ideal.clear();
        observe_accel(body, truth, b, 0.0, Eigen::Vector3d::Zero(), 1.0, 0.0, ideal);
        inertial.boards[b].accel = predicted() + noise(settings.accel_noise);
        inertial.boards[b].accel_valid = true;
      }
      filter_.process(inertial);

      // A pulse 4 ms ago: the filter compares it with the state carried back.
      constexpr double kAgo = -0.004;
      distances.stamp_ns = stamp - 4'000'000;
      distances.source = static_cast<std::size_t>(step) % garment.sources.size();
      for (std::size_t b = 0; b < garment.boards.size(); ++b) {
        DistanceReading& reading = distances.distances[b];
        reading = {};
        double guess = 0.5;
        for (int i = 0; i < 4; ++i) {
          ideal.clear();
          if (!observe_distance(body, truth, distances.source, b, kAgo, guess / 343.0, 0.0, 1.0,
                                ideal)) {
            break;
          }
          guess = -ideal.y[0];
        }
        if (ideal.size() == 0) continue;
        reading = {guess + draw.normal(true_noise_scale * settings.distance_noise), 1.0};
      }
      filter_.process(distances);
    }

    ModelResult result;
    difference(layout, truth, filter_.estimate(), span(error));
    const Eigen::MatrixXd P = dense(filter_.covariance(), n);
    result.nees = error.dot(P.ldlt().solve(error));
    const int joints = 3 * layout.groups;
    const Eigen::VectorXd e = error.head(joints);
    result.joint_nees = e.dot(P.topLeftCorner(joints, joints).ldlt().solve(e));
    result.least_eigenvalue = P.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff();
    result.gyro = filter_.gyro_fit();
    result.accel = filter_.accel_fit();
    result.distance = filter_.distance_fit();
    return result;
  }

 private:
  /// Calm motion, sensors as good as the paper's, and no gates or limits, which the model does not
  /// know of.
  static FilterSettings quiet() {
    FilterSettings s;
    s.rate_error = 0.0;  // rates err only as the model says
    s.joint_jerk = s.root_turn_jerk = 10.0;
    s.root_jerk = 3.0;
    s.gyro_noise = 0.05;
    s.accel_noise = 0.5;
    s.distance_noise = 0.01;
    s.chain_jerk = 3.0;
    s.mount_sigma = s.mount_tilt = 0.01;
    s.arm_sigma = 0.0;
    s.gate = 1.0 - 1e-9;
    s.limits = false;
    return s;
  }

  Eigen::MatrixXd noise_factor(const BodyLayout& layout, double dt) const {
    // The Q that the covariance itself adds to nothing in one step at rest.
    Covariance Q(layout, 8);
    BodyState rest;
    rest.groups.resize(static_cast<std::size_t>(layout.groups));
    rest.boards.resize(garment.boards.size());
    const auto square = [](double v) { return v * v; };
    Q.predict(rest, dt,
              {square(settings.joint_jerk), square(settings.root_turn_jerk),
               square(settings.root_jerk), square(settings.chain_jerk),
               square(settings.gyro_bias_walk), square(settings.accel_bias_walk),
               square(settings.mount_walk), square(settings.sound_walk)});
    // Its entries span eleven decades: factored after scaling to a unit diagonal.
    const Eigen::MatrixXd q = dense(Q, layout.size());
    const Eigen::VectorXd scale = q.diagonal().cwiseSqrt();
    const Eigen::VectorXd inverse = scale.cwiseInverse();
    const Eigen::MatrixXd unit = inverse.asDiagonal() * q * inverse.asDiagonal();
    const Eigen::MatrixXd L = unit.llt().matrixL();
    return scale.asDiagonal() * L;
  }

  BodyFilter filter_;
};

}  // namespace secondskin::server
