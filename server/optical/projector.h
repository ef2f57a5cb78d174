#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <optional>
#include <vector>

/// What calibration knows of a projector: the seven numbers that map a point to the value that a
/// detector there receives (Second Skin, 2.2.2).
///
/// h [v 1]^T = P [x y z 1]^T with P(1, 3) = 1; points in the world, z up [m]; v is the value in
/// counts, 1 to 254, h is the distance along the projector's axis in units of its distance from the
/// world's origin.
namespace secondskin::server {

/// a . p = b
struct Plane {
  Eigen::Vector3d a;
  double b;
};

struct Projector {
  Eigen::Matrix<double, 2, 4> P = Eigen::Matrix<double, 2, 4>::Zero();

  /// The value at a point, not rounded; meaningless behind the projector.
  double value(const Eigen::Vector3d& p_W) const noexcept {
    const Eigen::Vector2d hv = P.leftCols<3>() * p_W + P.col(3);
    return hv[0] / hv[1];
  }
  /// Its gradient dv/dp [counts/m], 1 x 3.
  Eigen::RowVector3d gradient(const Eigen::Vector3d& p_W) const noexcept {
    const Eigen::Vector2d hv = P.leftCols<3>() * p_W + P.col(3);
    return (P.row(0).head<3>() - (hv[0] / hv[1]) * P.row(1).head<3>()) / hv[1];
  }
  /// The plane of all points with that value, scaled as in 2.2.3 (the residual of a point is h
  /// times its error in counts).
  Plane plane(double value) const noexcept {
    return {(P.row(0).head<3>() - value * P.row(1).head<3>()).transpose(), value - P(0, 3)};
  }
};

/// All projectors of an installation by slot; empty where one is not calibrated.
struct ProjectorRig {
  std::vector<std::optional<Projector>> projectors;

  std::size_t size() const noexcept { return projectors.size(); }

  /// Reads the text file that save() writes.
  /// @throws std::runtime_error naming file, line and what was expected.
  static ProjectorRig load(const std::filesystem::path& file);
  /// Writes a text file: comments begin with '#', "projectors N", then a line a calibrated
  /// projector: slot and P11 P12 P13 P14 P21 P22 P23, for metres and z up, with all digits. The
  /// file appears whole or not at all. @throws std::system_error naming the file.
  void save(const std::filesystem::path& file) const;
};

}  // namespace secondskin::server
