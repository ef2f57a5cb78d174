#pragma once

#include <Eigen/Geometry>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "motion/body_shape.h"

/// A wearable capture garment: which sensor board and which ultrasonic source sits where on the
/// body (Practical Motion Capture in Everyday Surroundings, sections 3 and 3.1).
///
/// Frames: B a segment; S a sensor board, origin at its microphone, z away from the body, x along
/// the segment's axis towards its end; U an ultrasonic source, z the direction that it faces.
namespace secondskin {

/// What an accelerometer feels upwards at rest, by definition [m/s^2].
inline constexpr double kStandardGravity = 9.80665;

/// A board with microphone, three-axis gyroscope and three-axis accelerometer.
struct SensorBoard {
  std::string name;      ///< unique, e.g. "left_thigh"
  Joint segment{};       ///< the segment that it is sewn over
  double along = 0.5;    ///< as skin_place
  double angle = 0.0;    ///< as skin_place [rad]
  double turn = 0.0;     ///< of the board about its z [rad]
  double gyro_range{};   ///< largest rate that it can tell [rad/s]
  double accel_range{};  ///< largest specific force that it can tell [m/s^2]
};

/// A piezoelectric transducer that sends ten cycles of 40 kHz when its turn comes.
struct UltrasonicSource {
  std::string name;
  std::optional<Joint> segment;  ///< empty: fixed in the world, at p_W
  double along = 0.5, angle = 0.0;
  double standoff = 0.0;                          ///< away from the skin, e.g. a hat's brim [m]
  std::optional<Eigen::Vector3d> facing;          ///< in B or W; empty: away from the skin
  Eigen::Vector3d p_W = Eigen::Vector3d::Zero();  ///< of one that is fixed in the world [m]
};

/// Boards and sources in the order of their channels. Sources take turns in this order.
struct Garment {
  std::string name;
  double sample_rate_hz{};     ///< of the driver box's A/D converters
  std::size_t slot_samples{};  ///< from one source's pulse to the next one's
  double inertial_rate_hz{};
  double carrier_hz{};  ///< of the sources; another wearer's differ (section 6)
  std::vector<SensorBoard> boards;
  std::vector<UltrasonicSource> sources;

  /// Reads garments/NAME.toml. @throws std::runtime_error naming file, line, field and what was
  /// expected (doubled name, unknown segment, rates that do not fit).
  static Garment load(const std::filesystem::path& file);

  /// Time between two pulses [s]. 1120 samples in 8 ms: 2.75 m of sound (section 4.1).
  double slot() const noexcept { return static_cast<double>(slot_samples) / sample_rate_hz; }
};

/// Where a board sits on a body.
Eigen::Isometry3d board_place(const Skeleton& wearer, const SensorBoard& board) noexcept;

/// Where a source sits: X_BU, or X_WU for one that is fixed in the world.
Eigen::Isometry3d source_place(const Skeleton& wearer, const UltrasonicSource& source) noexcept;

}  // namespace secondskin
