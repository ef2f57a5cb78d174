#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <tl/expected.hpp>
#include <utility>
#include <vector>

#include "server/optical/calibrate/factorisation.h"
#include "server/optical/calibrate/refusal.h"
#include "server/optical/calibrate/rough_layout.h"
#include "server/optical/calibrate/value_sync.h"
#include "server/optical/projector.h"

/// Projector calibration without a grid (the wish of Second Skin 5.1): a wand with two or more
/// detectors is waved through the volume and laid on the floor.
///
/// The values alone give everything but scale, place, orientation and the choice between the world
/// and its mirror image. The wand's lengths give the scale; where it lies still gives the floor,
/// the origin and x. Three detectors that are not on one line tell the mirror image apart, and one
/// lay-down is a floor; two detectors need a rough layout of the projectors, and to be laid down at
/// three places or more. docs/projector-calibration.md has the equations.
namespace secondskin::server {

struct Wand {
  /// Where the detectors are as the wand lies on the floor for the first time, in the world that
  /// this defines: z is the height over the floor [m].
  std::vector<Eigen::Vector3d> lying_W;

  /// Reads a wand file (TOML): unit = "m", "cm", "mm" or "in"; lying = [[x, y, z], ...].
  /// @throws std::runtime_error naming file, line, field and what was expected.
  static Wand load(const std::filesystem::path& file);

  bool on_a_line() const;  ///< two detectors, or more in a row
};

struct WandSettings {
  NominalOptics optics;
  std::optional<RoughLayout> layout;  ///< where the projectors stand, to half a metre or so
  std::size_t frames = 400;           ///< solved for, three times as many where they are needed
  double length_sigma = 0.5e-3;       ///< how well the wand's lengths are known [m]
  double enough = 1e-3;               ///< predicted error that is good enough [m]
};

/// How far a projector's field is swept, from the values alone.
struct ProjectorSweep {
  static constexpr std::size_t kBins = 16;
  std::array<std::uint32_t, kBins> values{};  ///< synchronised values by bin of 16 counts
  double share() const noexcept;              ///< of the bins with kFull values or more
  static constexpr std::uint32_t kFull = 15;
};

struct WandProgress {
  std::uint64_t frames =
      0;  ///< synchronised ones with a place: a detector that four projectors see
  std::size_t lay_downs = 0;               ///< times that it lay still for kStill or longer
  bool still = false;                      ///< at this moment
  std::vector<ProjectorSweep> projectors;  ///< by slot
};

/// How one projector came out.
struct WandProjector {
  std::size_t sightings = 0;         ///< synchronised values of placed detectors
  double fitting = 0.0;              ///< share of them within 3 counts
  double residual = 0.0;             ///< RMS of those [counts]
  double focal = 0.0, middle = 0.0;  ///< its optics as found; see NominalOptics
  double field_share = 0.0;          ///< of 16 bins of values x 4 bins of distance that are swept
  std::optional<Refusal> refused;    ///< why it is not calibrated
};

struct WandResult {
  ProjectorRig rig;
  std::vector<WandProjector> projectors;  ///< by slot
  std::size_t frames = 0;                 ///< that were solved for
  double length_error = 0.0;     ///< of the wand's lengths, triangulated: 1.48 median |error| [m]
  double floor_rms = 0.0;        ///< heights of the lying detectors against the wand's [m]
  double predicted_error = 0.0;  ///< what the calibration adds to a point, 1 sigma, 3-D [m]
  /// What would make it better, for the user; empty when it is enough.
  std::vector<std::string> wishes;
  bool enough() const noexcept { return wishes.empty(); }
};

/// Collects frames and solves. A copy may be solved in another thread while this one goes on.
class WandSession {
 public:
  static constexpr double kStill = 1.0;  ///< lying so long counts as laid down [s]

  /// @throws std::invalid_argument when the wand has fewer than two detectors or two at one place,
  ///         or the layout has another number of projectors.
  WandSession(Wand wand, std::size_t projectors, WandSettings settings = {});

  /// Takes the next cycle; the wand's detectors are 0, 1, ... @throws as ValueSync::add()
  void add(const ProjectorFrame& frame);

  WandProgress progress() const { return progress_; }

  /// Solves with all frames so far; some seconds of one core. Refused with a reason when the
  /// frames do not give a calibration.
  tl::expected<WandResult, Refusal> solve() const;

 private:
  void find_still(const SyncedFrame& frame);

  Wand wand_;
  std::size_t projectors_;
  WandSettings settings_;
  ValueSync sync_;
  std::vector<SyncedFrame> frames_;
  std::vector<std::pair<std::size_t, std::size_t>> lying_;  ///< frames [first, last)
  std::size_t still_since_ = 0;  ///< frame from which on nothing has moved
  WandProgress progress_;
};

}  // namespace secondskin::server
