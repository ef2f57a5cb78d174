#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "motion/garment.h"
#include "server/wearable/measurement.h"

/// Finds the still phase with which a wearer begins (section 5.4) and averages what was felt in it.
namespace secondskin::server {

/// What one board felt while the wearer stood still.
struct BoardRest {
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();   ///< mean: its offset [rad/s]
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< mean: gravity, +g upwards, and its offset
  Eigen::Vector3d magnetic = Eigen::Vector3d::Zero();  ///< mean [T]
  double gyro_deviation = 0.0, accel_deviation = 0.0;  ///< of means over 0.1 s, RMS over the axes
  std::size_t gyro_readings = 0, accel_readings = 0;   ///< 0: the board said nothing
  std::size_t magnetic_readings = 0;
};

struct Rest {
  std::int64_t begin_ns = 0, end_ns = 0;
  std::vector<BoardRest> boards;
  /// Median distance of each board (column) from each source (row); NaN where none was heard [m].
  Eigen::MatrixXd distances;
  /// In the same order, how often it was heard, as a share of the source's pulses.
  Eigen::MatrixXd heard;
};

/// Counts who hears whom.
class Hearing {
 public:
  Hearing() = default;
  explicit Hearing(const Garment& garment);
  /// Whether a distance is sure enough, and no longer than a body: else it is an echo.
  bool counts(std::size_t source, const DistanceReading& reading, double confidence) const noexcept;
  void add(const Measurement& measurement, double confidence);
  Eigen::MatrixXd shares() const;  ///< source by board, 0 to 1
  double pulses() const noexcept { return pulses_.sum(); }

 private:
  std::vector<double> furthest_;  ///< by source: what is heard from further off is an echo [m]
  Eigen::MatrixXd heard_;
  Eigen::VectorXd pulses_;
};

struct RestSettings {
  double shortest = 0.5, longest = 3.0;  ///< [s]
  double gyro = 0.06;                    ///< a mean over 0.1 s strays at most so far [rad/s]
  double accel = 0.4;                    ///< [m/s^2]
  double turning = 0.15;      ///< steady turning above this is no offset of a gyroscope [rad/s]
  double confidence = 0.1;    ///< of a distance that counts
  double disobedient = 0.12;  ///< share of boards that may stray, e.g. a board that is loose
};

/// Means over 0.1 s are looked at: the 6-bit code's rounding (4.2) does not look like movement.
class RestFinder {
 public:
  RestFinder(const Garment& garment, const RestSettings& settings = {});

  /// @returns whether the rest is over and long enough: take rest()
  bool add(const Measurement& measurement);

  /// The stillness found so far; empty while it is too short.
  std::optional<Rest> rest() const;

 private:
  struct Sum {
    Eigen::Vector3d gyro = Eigen::Vector3d::Zero(), accel = Eigen::Vector3d::Zero(),
                    magnetic = Eigen::Vector3d::Zero();
    std::size_t gyros = 0, accels = 0, magnetics = 0;
  };
  struct Block {
    std::int64_t begin_ns = 0, end_ns = 0;
    std::vector<Sum> boards;
    struct Heard {
      std::size_t source, board;
      double distance;
    };
    std::vector<Heard> distances;
  };
  bool close_block();
  [[nodiscard]] bool strays(const Block& block) const;

  RestSettings settings_;
  std::size_t boards_, sources_;
  Hearing silence_;
  Block block_;
  std::vector<Block> run_;
  Hearing hearing_;       // since the run began
  std::vector<Sum> sum_;  // over the run
  bool over_ = false;
};

}  // namespace secondskin::server
