#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "server/pose_source.h"

/// What a worn sensor system measures, in physical units: the seam between signals (or files) and
/// the filter.
///
/// Frames: S a sensor board (motion/garment.h), W the world, z up.
namespace secondskin::server {

/// What one board felt at one instant.
struct BoardReading {
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();      ///< w_WS_S [rad/s]
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();     ///< specific force in S; +g upwards at rest
                                                       ///< [m/s^2]
  Eigen::Vector3d magnetic = Eigen::Vector3d::Zero();  ///< field in S [T]
  bool gyro_valid = false;  ///< false: not received, not correctable, or saturated
  bool accel_valid = false;
  bool magnetic_valid = false;  ///< the paper's boards have no magnetometer
};

/// How far one board's microphone was from a source, by the sound's time of flight.
struct DistanceReading {
  double distance = 0.0;    ///< between the source at emission and the microphone at arrival [m]
  double confidence = 0.0;  ///< w_s * w_t of section 4.1, 0 (no useful measurement) to 1; the
                            ///< filter adds w_a
};

enum class MeasurementKind : std::uint8_t {
  kInertial,   ///< `boards`
  kDistances,  ///< `source` and `distances`
};

/// All that was measured at one instant. Reused from call to call, so that nothing is allocated.
struct Measurement {
  MeasurementKind kind{};
  std::int64_t stamp_ns = 0;  ///< inertial: when it was sampled; distances: when the pulse was sent
  std::vector<BoardReading> boards;        ///< one per board of the garment
  std::size_t source = 0;                  ///< which source sent the pulse
  std::vector<DistanceReading> distances;  ///< one per board of the garment
};

/// Anything that yields measurements in the order in which they become known; stamps may go back a
/// little. Belongs to who filters them.
class MeasurementStream {
 public:
  virtual ~MeasurementStream() = default;
  /// As PoseSource::next.
  [[nodiscard]] virtual Next next(Measurement& measurement) = 0;
  virtual bool live() const { return false; }
  virtual bool rewind() { return false; }
  /// What was damaged or lost so far, for people; empty for nothing.
  virtual std::string trouble() const { return {}; }
};

}  // namespace secondskin::server
