#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "sim/wearable/garment_scene.h"

/// What one does with a garment's boards and sources to calibrate them (Practical Motion Capture,
/// 4.3): on stands at known distances, on a turntable, laid down in still poses.
namespace secondskin::sim {

/// Boards and sources on stands over a table, that stand still. A placement has all sources in a
/// row at x = 0 and all boards in rows before them, facing them.
class StandScene final : public GarmentScene {
 public:
  static constexpr double kNearest = 0.3, kFarthest = 0.9;  ///< 4.3 [m]
  static constexpr double kHeight = 0.35;                   ///< over the table [m]

  /// @param placement  another arrangement for each number
  /// @param seconds    how long it is recorded
  StandScene(Garment garment, const WornErrors& errors, std::uint64_t placement,
             double seconds = 2.0);

  const Garment& garment() const noexcept override { return garment_; }
  const WornErrors& errors() const noexcept override { return errors_; }
  double duration() const noexcept override { return seconds_; }
  void boards_at(double time, std::span<BoardTruth> boards) const noexcept override;
  void at(double time, GarmentInstant& out) const override;
  std::span<const Reflector> reflectors() const noexcept override { return table_; }

  double distance(std::size_t source, std::size_t board) const noexcept;  ///< [m]

 private:
  Garment garment_;
  WornErrors errors_;
  double seconds_;
  GarmentInstant still_;
  std::vector<Reflector> table_;
};

/// One stop of a BenchScene: the boards are turned by hand to an orientation, then lie still or
/// turn with the table.
struct BenchStop {
  Eigen::Quaterniond q_WS = Eigen::Quaterniond::Identity();  ///< of all boards, table at rest
  double seconds = 4.0;                                      ///< still, or at the table's full rate
  double rate = 0.0;                                         ///< of the table about W's z [rad/s]
};

/// All boards on a turntable about W's z, each a hand's breadth from its middle, stop after stop.
class BenchScene final : public GarmentScene {
 public:
  static constexpr double kMove = 1.5;     ///< turning by hand, speeding up, slowing down [s]
  static constexpr double kRadius = 0.08;  ///< of a board from the middle [m]

  /// @param slip  how far off a stop's orientation each board really is, RMS [rad]
  BenchScene(Garment garment, const WornErrors& errors, std::vector<BenchStop> stops,
             double slip = 0.0, std::uint64_t seed = 1);

  const Garment& garment() const noexcept override { return garment_; }
  const WornErrors& errors() const noexcept override { return errors_; }
  double duration() const noexcept override;
  void boards_at(double time, std::span<BoardTruth> boards) const noexcept override;
  void at(double time, GarmentInstant& out) const override;
  std::span<const Reflector> reflectors() const noexcept override { return {}; }

 private:
  Garment garment_;
  WornErrors errors_;
  std::vector<BenchStop> stops_;
  std::vector<Eigen::Quaterniond> slip_;  ///< board-major, one a stop
};

/// 4.3: each axis of the boards up and down, x up first.
std::vector<BenchStop> six_sides(double seconds = 4.0);
/// The same six on a turntable at a rate.
std::vector<BenchStop> six_turns(double rate, double seconds = 4.0);
/// Still poses in orientations of every kind.
std::vector<BenchStop> still_poses(std::size_t count, std::uint64_t seed, double seconds = 4.0);

}  // namespace secondskin::sim
