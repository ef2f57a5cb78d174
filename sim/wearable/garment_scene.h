#pragma once

#include <Eigen/Geometry>
#include <span>
#include <vector>

#include "motion/garment.h"
#include "sim/wearable/acoustic_shadow.h"

/// What a garment's boards and sources are on: a moving body (worn_garment.h), or a table.
///
/// Frames: W the world, z up; S a board as it is really mounted; U a source, z where it faces.
namespace secondskin::sim {

/// How the truth differs from what the filter assumes. RMS, of a vector over its three axes
/// together unless it says otherwise; each run draws its own from the seed. The defaults are a real
/// garment's on a real body.
struct WornErrors {
  double mounting_angle = 0.0873;  ///< of a board: 5 degrees [rad]
  double mounting_place = 0.01;    ///< of a board [m]
  double source_place = 0.005;     ///< of a source: less, as they sit on plates on the trunk [m]
  double bone = 0.01;              ///< relative error of each segment's length
  double tissue_place = 0.005;     ///< soft tissue moves boards and sources against the bone [m]
  double tissue_angle = 0.0524;    ///< the same, of boards: 3 degrees [rad]
  double tissue_hz = 3.0;          ///< its spectrum is even from 0.2 Hz up to here
  double gyro_noise = 0.002;       ///< of a sample and axis (5.2) [rad/s]
  double accel_noise = 0.02;       ///< of a sample and axis (5.2) [m/s^2]
  double gyro_bias = 0.0052;       ///< of an axis: 0.3 degrees/s, before rest zeroing [rad/s]
  double gyro_bias_walk = 2e-5;    ///< of an axis [rad/s per sqrt(s)]
  double accel_bias = 0.05;        ///< of an axis [m/s^2]
  double scale = 0.005;            ///< relative, of an axis
  double distance_noise = 0.0025;  ///< of a strong signal (5.2) [m]

  /// Sensors and body as the filter assumes them.
  static WornErrors none();
};

/// What a board truly feels, and where it is.
struct BoardTruth {
  Eigen::Isometry3d X_WS = Eigen::Isometry3d::Identity();  ///< soft tissue included
  Eigen::Vector3d v = Eigen::Vector3d::Zero();             ///< of S's origin in W [m/s]
  Eigen::Vector3d a = Eigen::Vector3d::Zero();             ///< of S's origin in W [m/s^2]
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();          ///< w_WS_S without sensor errors [rad/s]
  Eigen::Vector3d accel =
      Eigen::Vector3d::Zero();  ///< specific force in S without sensor errors [m/s^2]
};

/// All that the sound of one slot is made of.
struct GarmentInstant {
  std::vector<BoardTruth> boards;
  std::vector<Eigen::Isometry3d> sources;  ///< X_WU
  std::vector<Eigen::Vector3d> source_v;   ///< of their origins in W [m/s]
  std::vector<Limb> limbs;                 ///< what hides and reflects sound
};

/// A large flat thing that reflects sound.
struct Reflector {
  Eigen::Vector3d n_W;  ///< unit, towards the room
  double offset;        ///< n_W . p of its points [m]
  double amplitude;     ///< of the reflected sound, 0 to 1
};

class GarmentScene {
 public:
  virtual ~GarmentScene() = default;
  virtual const Garment& garment() const noexcept = 0;
  virtual const WornErrors& errors() const noexcept = 0;  ///< of its sensors
  virtual double duration() const noexcept = 0;           ///< [s]
  /// @param boards  one per board of the garment. No allocation.
  virtual void boards_at(double time, std::span<BoardTruth> boards) const noexcept = 0;
  /// @param out  reused; allocates the first time only
  virtual void at(double time, GarmentInstant& out) const = 0;
  virtual std::span<const Reflector> reflectors() const noexcept = 0;
};

/// What is left of a source's direct sound at each board. @param wavelength [m]
inline void shadows(const GarmentInstant& instant, std::size_t source, double wavelength,
                    std::span<Shadow> out) noexcept {
  for (std::size_t board = 0; board < out.size(); ++board) {
    out[board] =
        acoustic_shadow(instant.sources[source].translation(),
                        instant.boards[board].X_WS.translation(), instant.limbs, wavelength);
  }
}

}  // namespace secondskin::sim
