#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <numbers>
#include <optional>
#include <random>
#include <span>
#include <vector>

/// Projectors and detectors that behave as Second Skin 2.1 and 2.3 describe them.
///
/// Frames: W the world, z up, origin on the floor in the middle of the circle; J a projector: z
/// along its axis into the scene, x across its stripes in the direction of rising values.
namespace secondskin::sim {

struct VirtualProjector {
  Eigen::Isometry3d X_WJ = Eigen::Isometry3d::Identity();
  double field = std::numbers::pi / 6.0;  ///< full angle, across and along the stripes (2.3) [rad]
  double nearest = 0.0;                   ///< usable range [m]
  double farthest = 35.0 * 0.3048;        ///< 2.3 [m]
  double mask_tilt = 0.0;  ///< the mask not parallel to the lenses: blurs the stripes [counts]
  bool dark = false;       ///< shows nothing, not even the sync bit

  /// Where on the mask a point is lit: 0 to 256 across the field, linear in the tangent; empty
  /// outside the field or the range. Value k is the stripe from k to k + 1.
  std::optional<double> coordinate(const Eigen::Vector3d& p_W) const noexcept;
  /// The true P of 2.2.2 for values in counts and metres: coordinate() - 0.5, so that a received
  /// value is the nearest whole number and none of its error is systematic. As in 2.2.2, h is 1 at
  /// the world's origin, which must not lie beside the projector.
  Eigen::Matrix<double, 2, 4> matrix() const noexcept;
};

/// Sixteen projectors in perpendicular pairs on a circle of 22 feet (2.3), level, 0.85 m high,
/// looking at the middle. Slots go around the circle; in a pair the first codes from the right to
/// the left as one stands in the middle and faces it, the second from the floor up.
std::vector<VirtualProjector> second_skin_rig();

/// A detector at one instant.
struct DetectorState {
  Eigen::Vector3d p_W;  ///< [m]
  Eigen::Vector3d n_W;  ///< unit, where it looks; zero: everywhere (under a ball that diffuses)
};

/// What carries detectors: a suit on a moving body, the calibration grid, the wand.
class OpticalScene {
 public:
  virtual ~OpticalScene() = default;
  virtual std::size_t detectors() const = 0;
  /// The state of all detectors at a time [s] from the beginning. Cheap, no allocation.
  virtual void at(double time, std::span<DetectorState> states) = 0;
  /// Whether the body at the time of the last at() stands between that detector and a point.
  virtual bool hidden(std::size_t detector, const Eigen::Vector3d& p_W) const = 0;
};

/// What is not ideal about projectors and detectors.
struct OpticalNoise {
  double view = 70.0 * std::numbers::pi / 180.0;  ///< half angle that a detector sees [rad]
  double grazing =
      8.0 * std::numbers::pi / 180.0;  ///< within so much of the edge bits get lost: wild values
  double count_sigma = 0.5;            ///< noise of the stripe's edge, before rounding [counts]
  double wild_share = 0.0;             ///< further share of values that are replaced by any value
  double dropped_sync = 0.0;  ///< share of a detector's cycles without a sync bit: all zeros
};

/// Computes what detectors receive: bit by bit, each at its own time, so a moving detector gets a
/// code of several places.
class VirtualRig {
 public:
  /// @param scene  borrowed
  VirtualRig(std::vector<VirtualProjector> projectors, OpticalScene& scene,
             const OpticalNoise& noise, std::uint64_t seed);

  std::vector<VirtualProjector>& projectors() noexcept { return projectors_; }
  std::size_t detectors() const { return scene_.detectors(); }

  /// One cycle that begins at a time [s]. No allocation.
  /// @param values  out: detector-major, 0 to 254
  void cycle(double time, std::span<std::uint8_t> values);
  /// Which detectors received the last cycle's sync bit. A tag of which none did sends nothing.
  std::span<const std::uint8_t> synced() const noexcept { return synced_; }

 private:
  std::vector<VirtualProjector> projectors_;
  OpticalScene& scene_;
  OpticalNoise noise_;
  bool sees_sync(std::size_t detector);
  std::uint8_t receive(const VirtualProjector& projector, std::size_t slot, std::size_t detector);

  std::mt19937_64 random_;
  std::normal_distribution<double> normal_;
  std::uniform_real_distribution<double> uniform_;
  std::vector<DetectorState> states_;  ///< when a slot begins
  std::vector<DetectorState> next_;    ///< when it ends
  std::vector<std::uint8_t> synced_;
};

}  // namespace secondskin::sim
