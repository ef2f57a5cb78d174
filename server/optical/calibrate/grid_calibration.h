#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <tl/expected.hpp>
#include <utility>
#include <vector>

#include "server/optical/calibrate/refusal.h"
#include "server/optical/projector.h"
#include "server/optical/projector_frame.h"

/// Projector calibration with the grid of known points (Second Skin, 2.2.2).
///
/// The grid stands still at each of its heights while its detectors are turned to all projectors.
/// All readings of a detector from a projector at a height become one value.
namespace secondskin::server {

/// The calibration grid: where its detectors are. In the world, z up [m].
struct CalibrationGrid {
  std::vector<Eigen::Vector3d> p_W;  ///< in the order of the tags' inputs, at the first height
  std::vector<double> heights;       ///< the grid's above the first one; the first is 0 [m]

  /// Reads a grid file (TOML): unit = "m", "cm", "mm", "in" or "0.1in"; up = "y" or "z";
  /// detectors = [[x, y, z], ...]; heights = [0, ...]. With y up, as in the paper, the file's
  /// z, x, y become the world's x, y, z.
  /// @throws std::runtime_error naming file, line, field and what was expected.
  static CalibrationGrid load(const std::filesystem::path& file);
};

/// How one projector came out.
struct GridProjector {
  std::size_t points = 0;          ///< detectors times heights that were read
  std::size_t fitting = 0;         ///< of them within 3 counts
  double residual = 0.0;           ///< RMS of those [counts]
  double residual_mm = 0.0;        ///< the same in the middle of the grid's places
  std::optional<Refusal> refused;  ///< why it is not calibrated
};

struct GridResult {
  ProjectorRig rig;
  std::vector<GridProjector> projectors;  ///< by slot
};

/// Collects readings and solves. Not for several threads at once.
class GridCalibration {
 public:
  static constexpr std::uint32_t kLeastReadings = 8;  ///< of a detector, projector and height

  /// @throws std::invalid_argument when the grid has no detectors or no height
  GridCalibration(CalibrationGrid grid, std::size_t projectors);

  /// @param height  index of the height at which the grid stands
  /// @throws std::invalid_argument when the frame has other detectors or projectors, or there is
  ///         no such height.
  void add(const ProjectorFrame& frame, std::size_t height);

  /// The value of all readings so far: their mean without the wild ones; empty while there are
  /// fewer than kLeastReadings. A guide for the user while turning the detectors. [counts]
  std::optional<double> value(std::size_t detector, std::size_t projector,
                              std::size_t height) const;

  /// Fits all projectors. Refused when none can be fitted, and when the values fit only with
  /// detectors in each other's place: the text names them (numbers count from 0).
  tl::expected<GridResult, Refusal> solve() const;

 private:
  struct Histogram {
    std::vector<std::uint32_t> counts = std::vector<std::uint32_t>(256, 0);
  };
  const Histogram& histogram(std::size_t detector, std::size_t projector,
                             std::size_t height) const {
    return histograms_[(height * grid_.p_W.size() + detector) * projectors_ + projector];
  }

  CalibrationGrid grid_;
  std::size_t projectors_;
  std::vector<Histogram> histograms_;
};

}  // namespace secondskin::server
