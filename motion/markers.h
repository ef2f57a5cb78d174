#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// Labelled points on a body: reflective markers, photodetectors, what a C3D or TRC file holds.
/// Frame: W the world, z up; metres.
namespace secondskin {

/// All markers at one instant.
struct MarkerFrame {
  std::vector<Eigen::Vector3d> p_WM;  ///< one per marker [m]; means nothing where not visible
  std::vector<std::uint8_t> visible;  ///< 1 where the marker was measured; one per marker
  std::vector<float> residual;        ///< how far off it may be, as its source says [m]; 0: unknown

  MarkerFrame() = default;
  /// `markers` markers, none of them visible.
  explicit MarkerFrame(std::size_t markers)
      : p_WM(markers, Eigen::Vector3d::Zero()), visible(markers, 0), residual(markers, 0.0F) {}
};

/// Labelled markers at equal steps of time.
struct MarkerMotion {
  std::vector<std::string> names;  ///< one per marker, unique, as in the file
  double rate_hz = 0.0;            ///< frames a second, > 0
  std::vector<MarkerFrame> frames;

  /// The marker of that name, or of the name behind a subject's prefix ("Derrick:LFHD" is LFHD).
  std::optional<std::size_t> find(std::string_view name) const noexcept;
};

}  // namespace secondskin
