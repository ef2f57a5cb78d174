#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <vector>

#include "motion/garment.h"
#include "server/wearable/signal/ultrasound.h"
#include "wire/inertial_code.h"

/// What turns a garment's raw values into physical ones (Practical Motion Capture, 4.3).
namespace secondskin::server {

/// Zero crossing and slope of each axis of a board: physical = slope * (code - zero).
struct BoardCalibration {
  Eigen::Vector3d gyro_zero, accel_zero;    ///< [code], 32 nominally
  Eigen::Vector3d gyro_slope, accel_slope;  ///< [rad/s a code], [m/s^2 a code]
};

struct WearableCalibration {
  std::string garment;
  double temperature = 20.0;  ///< of the air as the offsets were measured [deg C]; for the record
  std::vector<SourceCalibration> sources;  ///< in the garment's order
  std::vector<BoardCalibration> boards;

  /// What a garment's ranges say, and the paper's 40 samples for all sources.
  static WearableCalibration nominal(const Garment& garment);

  /// Reads a calibration file (TOML); sources and boards that it does not name stay nominal.
  /// @throws std::runtime_error naming file, line, field and what was expected; another garment's
  ///         file is refused.
  static WearableCalibration load(const std::filesystem::path& file, const Garment& garment);

  /// @throws std::system_error naming the file when it cannot be written.
  void save(const std::filesystem::path& file, const Garment& of) const;
};

/// One board's codes in physical units: [rad/s] and [m/s^2], in S.
Eigen::Vector3d gyro_of(const wire::InertialCode& code, const BoardCalibration& board) noexcept;
Eigen::Vector3d accel_of(const wire::InertialCode& code, const BoardCalibration& board) noexcept;

/// Whether an axis of the three from `first` on is at an end of its range: what it says is too
/// little.
bool saturated(const wire::InertialCode& code, std::size_t first) noexcept;

}  // namespace secondskin::server
