#include "sim/wearable/inertial_sensor.h"

#include <algorithm>
#include <cmath>

namespace secondskin::sim {
namespace {

constexpr double kFineSteps = 4096.0;  // 12 bits
constexpr double kCoarseSteps = 64.0;  // 6 bits

}  // namespace

InertialSensor::InertialSensor(const SensorBoard& board, const WornErrors& errors,
                               std::uint64_t seed, bool codec)
    : walk_(errors.gyro_bias_walk), codec_(codec), random_(seed) {
  gyro_.bias = draw(errors.gyro_bias);
  gyro_.scale = draw(errors.scale);
  gyro_.noise = errors.gyro_noise;
  gyro_.range = board.gyro_range;
  accel_.bias = draw(errors.accel_bias);
  accel_.scale = draw(errors.scale);
  accel_.noise = errors.accel_noise;
  accel_.range = board.accel_range;
}

Eigen::Vector3d InertialSensor::draw(double sigma) noexcept {
  const double x = normal_(random_), y = normal_(random_), z = normal_(random_);
  return sigma * Eigen::Vector3d(x, y, z);
}

bool InertialSensor::read(Axes& axes, const Eigen::Vector3d& truth, Eigen::Vector3d& out) noexcept {
  const Eigen::Vector3d noise = draw(axes.noise);
  bool within = true;
  for (Eigen::Index i = 0; i < 3; ++i) {
    double value = (1.0 + axes.scale[i]) * truth[i] + axes.bias[i] + noise[i];
    within = within && std::abs(value) < axes.range;
    value = std::clamp(value, -axes.range, axes.range);
    if (codec_) {
      const double fine = 2.0 * axes.range / kFineSteps, coarse = 2.0 * axes.range / kCoarseSteps;
      const double wanted = std::round(value / fine) * fine + axes.carried[i];
      value =
          std::clamp(std::round(wanted / coarse), -0.5 * kCoarseSteps, 0.5 * kCoarseSteps - 1.0) *
          coarse;
      axes.carried[i] = std::clamp(wanted - value, -coarse, coarse);  // does not wind up
    }
    out[i] = value;
  }
  return within;
}

void InertialSensor::read(const BoardTruth& truth, double dt, server::BoardReading& out) noexcept {
  gyro_.bias += draw(walk_ * std::sqrt(std::max(0.0, dt)));
  out.gyro_valid = read(gyro_, truth.gyro, out.gyro);
  out.accel_valid = read(accel_, truth.accel, out.accel);
  out.magnetic_valid = false;
}

}  // namespace secondskin::sim
