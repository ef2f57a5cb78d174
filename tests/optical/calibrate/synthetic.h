#pragma once

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "server/optical/calibrate/triangulation.h"
#include "server/optical/projector.h"
#include "server/optical/projector_frame.h"
#include "wire/photo_tag.h"

// Projectors and a wand of the test's own, independent of sim/.
namespace secondskin::server::test {

inline double radians(double degrees) { return degrees * std::numbers::pi / 180.0; }

/// A 1-D projector at p_W that looks at a point; its stripes turned about the axis by `roll`.
inline Projector make_projector(const Eigen::Vector3d& p_W, const Eigen::Vector3d& target_W,
                                double roll, double focal = 128.0 / std::tan(radians(15.0)),
                                double middle = 127.5) {
  const Eigen::Vector3d z = (target_W - p_W).normalized();
  const Eigen::Vector3d right = z.cross(Eigen::Vector3d::UnitZ()).normalized();
  const Eigen::Vector3d up = right.cross(z);
  const Eigen::Vector3d x = std::cos(roll) * right + std::sin(roll) * up;
  Projector projector;
  projector.P.row(0).head<3>() = (focal * x + middle * z).transpose();
  projector.P.row(1).head<3>() = z.transpose();
  projector.P.col(3) = -projector.P.leftCols<3>() * p_W;
  projector.P /= projector.P(1, 3);
  return projector;
}

/// Pairs on a circle of 22 feet; no two alike.
inline std::vector<Projector> make_rig(std::size_t projectors = 16, unsigned seed = 1) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Projector> rig;
  for (std::size_t i = 0; i < projectors; ++i) {
    const double azimuth = 2.0 * std::numbers::pi * static_cast<double>(i / 2) /
                               static_cast<double>((projectors + 1) / 2) +
                           0.05 * normal(random);
    const double height = 1.2 + 0.15 * normal(random) + (i % 2 == 0 ? 0.0 : 0.2);
    const Eigen::Vector3d p(3.35 * std::cos(azimuth), 3.35 * std::sin(azimuth), height);
    const Eigen::Vector3d target(0.05 * normal(random), 0.05 * normal(random),
                                 0.95 + 0.05 * normal(random));
    rig.push_back(
        make_projector(p, target, radians(45.0 + (i % 2 == 0 ? 0.0 : 90.0) + 3.0 * normal(random)),
                       477.7 * (1.0 + 0.02 * normal(random)), 127.5 + 2.0 * normal(random)));
  }
  return rig;
}

struct Noise {
  double sigma = 0.5;  ///< [counts]
  double wild = 0.02;  ///< share
};

/// What a detector at a place receives: 0 outside the field.
inline std::uint8_t receive(const Projector& projector, const Eigen::Vector3d& p_W,
                            const Noise& noise, std::mt19937& random) {
  const Eigen::Vector2d hv = projector.P.leftCols<3>() * p_W + projector.P.col(3);
  if (hv[1] <= 0.0) return wire::kNoValue;
  const double value = hv[0] / hv[1];
  if (value < 1.0 || value > 254.0) return wire::kNoValue;
  if (std::uniform_real_distribution<double>()(random) < noise.wild) {
    return static_cast<std::uint8_t>(std::uniform_int_distribution<int>(1, 254)(random));
  }
  const double noisy = value + noise.sigma * std::normal_distribution<double>()(random);
  return static_cast<std::uint8_t>(std::clamp(std::lround(noisy), 1L, 254L));
}

/// A wand that lies on the floor at the world's origin for two seconds, is then waved through the
/// volume, and at some times laid on the floor elsewhere.
class WavedWand {
 public:
  static constexpr double kLies = 2.0;  ///< [s]

  /// @param lying_W  its detectors as it first lies
  /// @param more     further lay-downs of kLies each, [s] and place and heading
  struct LayDown {
    double from;
    Eigen::Vector2d p_W;
    double heading;
  };
  explicit WavedWand(std::vector<Eigen::Vector3d> lying_W, unsigned seed = 3,
                     std::vector<LayDown> more = {}, double reach = 1.0)
      : lying_W_(std::move(lying_W)), more_(std::move(more)), reach_(reach) {
    more_.push_back({0.0, Eigen::Vector2d::Zero(), 0.0});
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> phase(0.0, 2.0 * std::numbers::pi);
    for (double& p : phase_) p = phase(random);
  }

  /// The wand's frame B is the world as it first lay.
  Eigen::Isometry3d X_WB(double t) const {
    Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
    for (const LayDown& lay : more_) {
      if (t < lay.from || t >= lay.from + kLies) continue;
      X.translation() << lay.p_W, 0.0;
      X.linear() = Eigen::AngleAxisd(lay.heading, Eigen::Vector3d::UnitZ()).toRotationMatrix();
      return X;
    }
    const double r = 0.6 * (1.0 + 0.6 * std::sin(0.23 * t + phase_[0]));
    const double a = 0.7 * t + phase_[1];
    X.translation() << r * std::cos(a), r * std::sin(a),
        0.95 + reach_ * 0.7 * std::sin(0.83 * t + phase_[2]);
    X.linear() =
        (Eigen::AngleAxisd(reach_ * (0.37 * t + phase_[3]), Eigen::Vector3d::UnitX()) *
         Eigen::AngleAxisd(0.9 * t + phase_[5], Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(reach_ * 1.2 * std::sin(0.71 * t + phase_[4]), Eigen::Vector3d::UnitY()))
            .toRotationMatrix();
    return X;
  }
  Eigen::Vector3d place(std::size_t detector, double t) const {
    return X_WB(t) * lying_W_[detector];
  }
  std::size_t detectors() const { return lying_W_.size(); }

 private:
  std::vector<Eigen::Vector3d> lying_W_;
  std::vector<LayDown> more_;
  double reach_;
  double phase_[6];
};

/// Where a projector stands but for a shift along its stripes, which its matrix does not know: the
/// point of its line nearest to a point.
inline Eigen::Vector3d centre_near(const Projector& projector, const Eigen::Vector3d& p) {
  const Eigen::Matrix<double, 2, 3> A = projector.P.leftCols<3>();
  const Eigen::Vector2d b = -projector.P.col(3) - A * p;
  return p + A.transpose() * (A * A.transpose()).inverse() * b;
}

/// The cycle that begins at `t` [s], every value at its own slot's time.
inline ProjectorFrame wave_cycle(const std::vector<Projector>& rig, const WavedWand& wand,
                                 std::uint64_t cycle, double t, const Noise& noise,
                                 std::mt19937& random) {
  ProjectorFrame frame(wand.detectors(), rig.size());
  frame.cycle = cycle;
  frame.stamp_ns = static_cast<std::int64_t>(std::llround(t * 1e9));
  for (std::size_t i = 0; i < rig.size(); ++i) {
    const double ti = t + 1e-9 * static_cast<double>(wire::value_time_ns(i));
    for (std::size_t d = 0; d < wand.detectors(); ++d) {
      frame.values[d * rig.size() + i] = receive(rig[i], wand.place(d, ti), noise, random);
    }
  }
  return frame;
}

/// RMS of what two rigs make of the same noise-free values, at points of the tracking volume that
/// six projectors of the true rig light. @param aligned  after the best rigid motion
inline double rig_error(const std::vector<Projector>& truth, const ProjectorRig& rig,
                        bool aligned) {
  std::mt19937 random(9);
  std::uniform_real_distribution<double> uniform;
  ProjectorRig all;
  for (const Projector& projector : truth) all.projectors.emplace_back(projector);
  std::vector<Eigen::Vector3d> from, to;
  for (int k = 0; k < 1000; ++k) {
    const double r = 0.99 * std::sqrt(uniform(random)),
                 a = 2.0 * std::numbers::pi * uniform(random);
    const Eigen::Vector3d p(r * std::cos(a), r * std::sin(a), 1.83 * uniform(random));
    std::vector<Sighting> sightings;
    for (std::size_t i = 0; i < truth.size(); ++i) {
      const double v = truth[i].value(p);
      if (v > 1.0 && v < 254.0 && rig.projectors[i]) sightings.push_back({i, v});
    }
    if (sightings.size() < 6) continue;
    // Six may be too nearly parallel for a place; then no calibration can give one.
    if (!triangulate(all, sightings)) continue;
    const auto found = triangulate(rig, sightings);
    if (!found) return std::numeric_limits<double>::infinity();
    from.push_back(found->p_W);
    to.push_back(p);
  }
  Eigen::Matrix3Xd A(3, static_cast<Eigen::Index>(from.size())), B(3, A.cols());
  for (std::size_t k = 0; k < from.size(); ++k) {
    A.col(static_cast<Eigen::Index>(k)) = from[k];
    B.col(static_cast<Eigen::Index>(k)) = to[k];
  }
  if (aligned) {
    const Eigen::Matrix4d T = Eigen::umeyama(A, B, false);
    A = ((T.topLeftCorner<3, 3>() * A).colwise() + T.topRightCorner<3, 1>()).eval();
  }
  return std::sqrt((A - B).colwise().squaredNorm().mean());
}

}  // namespace secondskin::server::test
