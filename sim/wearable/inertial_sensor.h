#pragma once

#include <cstdint>
#include <random>

#include "server/wearable/measurement.h"
#include "sim/wearable/garment_scene.h"

/// A board's gyroscopes and accelerometers with their errors: reading = (1 + scale) truth + bias +
/// noise, per axis, out of range not valid.
namespace secondskin::sim {

class InertialSensor {
 public:
  /// @param codec  give out 6-bit values, as sections 3.3 and 4.2 describe them: a 12-bit reading
  ///               rounded to 6 bits of the full range, the rounding error carried into the next
  InertialSensor(const SensorBoard& board, const WornErrors& errors, std::uint64_t seed,
                 bool codec);

  /// The next sample. @param dt  since the last one [s]
  void read(const BoardTruth& truth, double dt, server::BoardReading& out) noexcept;

  const Eigen::Vector3d& gyro_bias() const noexcept { return gyro_.bias; }    ///< [rad/s]
  const Eigen::Vector3d& accel_bias() const noexcept { return accel_.bias; }  ///< [m/s^2]
  const Eigen::Vector3d& gyro_scale() const noexcept { return gyro_.scale; }  ///< relative error
  const Eigen::Vector3d& accel_scale() const noexcept { return accel_.scale; }

 private:
  struct Axes {
    Eigen::Vector3d bias, scale;
    Eigen::Vector3d carried = Eigen::Vector3d::Zero();
    double noise, range;
  };
  bool read(Axes& axes, const Eigen::Vector3d& truth, Eigen::Vector3d& out) noexcept;
  Eigen::Vector3d draw(double sigma) noexcept;

  Axes gyro_, accel_;
  double walk_;
  bool codec_;
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_;
};

}  // namespace secondskin::sim
