#pragma once

#include <vector>

#include "sim/optical/suit_scene.h"

/// What carries detectors while one calibrates: the grid, the wand, the tongs.
namespace secondskin::sim {

/// The grid of 2.2.2: twelve detectors, four by three on 4 x 4 feet, over the world's origin, on
/// posts that turn, so that each detector looks at every projector in turn without moving.
class GridScene final : public OpticalScene {
 public:
  static constexpr double kRaised = 36.0 * 0.0254;  ///< 2.2.2: 36 inches [m]

  /// @param height  of the detectors: 0 or kRaised [m]
  /// @param turn    time of a whole turn of the posts [s]
  explicit GridScene(double height, double turn = 16.0);

  std::size_t detectors() const override { return positions_.size(); }
  void at(double time, std::span<DetectorState> states) override;
  bool hidden(std::size_t, const Eigen::Vector3d&) const override { return false; }

  /// Where the detectors are, in W [m].
  std::span<const Eigen::Vector3d> positions() const noexcept { return positions_; }

 private:
  std::vector<Eigen::Vector3d> positions_;
  double turn_;
};

struct WandOptions {
  /// The detectors in the wand's frame T [m]. The paper has none; a set square tells the floor too.
  std::vector<Eigen::Vector3d> p_TD{{0.0, 0.0, 0.0}, {0.5, 0.0, 0.0}, {0.0, 0.35, 0.0}};
  double wave = 60.0;         ///< how long it is waved [s]
  double lay_down = 2.0;      ///< then brought to the floor [s]; there it stays
  double rest_height = 0.03;  ///< of T over the floor when it lies: T is W but for this [m]
};

/// A rigid wand, waved through the whole tracking volume and all orientations by a smooth random
/// motion, then laid down at the origin. Its detectors sit under balls that diffuse: they see
/// everywhere.
class WandScene final : public OpticalScene {
 public:
  explicit WandScene(WandOptions options = {}, std::uint64_t seed = 1);

  std::size_t detectors() const override { return options_.p_TD.size(); }
  void at(double time, std::span<DetectorState> states) override;
  bool hidden(std::size_t, const Eigen::Vector3d&) const override { return false; }

  const WandOptions& options() const noexcept { return options_; }
  /// From when on it lies still [s].
  double rests_from() const noexcept { return options_.wave + options_.lay_down; }

 private:
  /// A smooth random function of time: a few slow sines.
  struct Wave {
    struct Sine {
      double omega, phase;
    };
    std::array<Sine, 5> sines;
    double operator()(double time) const noexcept;  ///< about evenly in (-1, 1)
  };

  Eigen::Isometry3d waved(double time) const noexcept;

  WandOptions options_;
  std::array<Wave, 6> waves_;  ///< place (3), orientation (3)
};

/// The tongs of 3.2 around a joint of a body that wears a suit: two more detectors, the joint's
/// centre in the middle between them.
class TongsScene final : public OpticalScene {
 public:
  /// @param body   borrowed
  /// @param joint  whose centre the tongs hold
  /// @param gap    between the skin and a detector [m]
  TongsScene(SuitScene& body, Joint joint, double gap = 0.02);

  /// The suit's, then the two of the tongs.
  std::size_t detectors() const override { return body_.detectors() + 2; }
  void at(double time, std::span<DetectorState> states) override;
  bool hidden(std::size_t detector, const Eigen::Vector3d& p_W) const override;

 private:
  SuitScene& body_;
  Joint joint_;
  double reach_;  ///< from the centre to a detector [m]
};

}  // namespace secondskin::sim
