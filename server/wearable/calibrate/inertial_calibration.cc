#include "server/wearable/calibrate/inertial_calibration.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <vector>

namespace secondskin::server {
namespace {

constexpr std::array<char, 3> kAxes{'x', 'y', 'z'};
constexpr double kUpright = 0.2079;       // sine of 12 degrees
constexpr double kSameRate = 0.15;        // share of a turntable's rate, on its axis and across
constexpr double kStill = 0.2;            // a rate that an uncalibrated zero may show [rad/s]
constexpr double kOtherPose = 0.9659258;  // cosine of 15 degrees
constexpr int kMostSteps = 50;

Eigen::Vector3d rate_of(const SteadyPart& part, const BoardCalibration& board) {
  return board.gyro_slope.cwiseProduct(part.mean.head<3>() - board.gyro_zero);
}

Eigen::Vector3d force_of(const SteadyPart& part, const BoardCalibration& board) {
  return board.accel_slope.cwiseProduct(part.mean.tail<3>() - board.accel_zero);
}

bool still(const SteadyPart& part, const BoardCalibration& board) {
  return rate_of(part, board).cwiseAbs().maxCoeff() < kStill;
}

// A mean of the codes of an axis in one direction.
struct Side {
  double sum = 0.0, weight = 0.0;
  void add(double code, std::size_t samples) {
    sum += code * static_cast<double>(samples);
    weight += static_cast<double>(samples);
  }
  double mean() const { return sum / weight; }
};
using Sides = std::array<std::array<Side, 2>, 3>;  // [axis][0: along, 1: against]

// Zero and slope of each axis from what it reads at +value and -value.
AxesFit from_sides(const Sides& sides, double value) {
  AxesFit fit;
  for (Eigen::Index i = 0; i < 3; ++i) {
    const auto& [plus, minus] = sides[static_cast<std::size_t>(i)];
    fit.zero[i] = 0.5 * (plus.mean() + minus.mean());
    fit.slope[i] = 2.0 * value / (plus.mean() - minus.mean());
  }
  return fit;
}

std::string missing_sides(const Sides& sides) {
  std::string missing;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t side = 0; side < 2; ++side) {
      if (sides[i][side].weight > 0.0) continue;
      if (!missing.empty()) missing += ", ";
      missing += fmt::format("{} {}", kAxes[i], side == 0 ? "up" : "down");
    }
  }
  return missing;
}

// Poses that differ, each the mean of its parts.
std::vector<Eigen::Vector3d> poses_of(std::span<const SteadyPart> parts,
                                      const BoardCalibration& nominal) {
  struct Pose {
    Eigen::Vector3d direction, sum;
    double weight;
  };
  std::vector<Pose> poses;
  for (const SteadyPart& part : parts) {
    if (!still(part, nominal)) continue;
    const Eigen::Vector3d direction = force_of(part, nominal).normalized();
    const auto weight = static_cast<double>(part.samples);
    Pose* same = nullptr;
    for (Pose& pose : poses) {
      if (pose.direction.dot(direction) > kOtherPose) same = &pose;
    }
    if (same == nullptr) {
      poses.push_back({direction, weight * part.mean.tail<3>(), weight});
    } else {
      same->sum += weight * part.mean.tail<3>();
      same->weight += weight;
    }
  }
  std::vector<Eigen::Vector3d> codes;
  for (const Pose& pose : poses) codes.push_back(pose.sum / pose.weight);
  return codes;
}

}  // namespace

tl::expected<AxesFit, WearableRefusal> accelerometer_by_axes(std::span<const SteadyPart> parts,
                                                             const BoardCalibration& nominal) {
  Sides sides;
  std::size_t used = 0;
  for (const SteadyPart& part : parts) {
    if (!still(part, nominal)) continue;
    const Eigen::Vector3d up = force_of(part, nominal).normalized();
    Eigen::Index axis = 0;
    up.cwiseAbs().maxCoeff(&axis);
    if (std::sqrt(1.0 - up[axis] * up[axis]) > kUpright) continue;
    sides[static_cast<std::size_t>(axis)][up[axis] > 0.0 ? 0 : 1].add(part.mean[3 + axis],
                                                                      part.samples);
    ++used;
  }
  if (const std::string missing = missing_sides(sides); !missing.empty()) {
    return tl::unexpected(WearableRefusal{
        fmt::format("not seen lying still for 3 s with its {}; lay it so, by a level", missing)});
  }
  AxesFit fit = from_sides(sides, kStandardGravity);
  fit.parts = used;
  return fit;
}

tl::expected<AxesFit, WearableRefusal> accelerometer_by_poses(std::span<const SteadyPart> parts,
                                                              const BoardCalibration& nominal) {
  const auto poses = poses_of(parts, nominal);
  if (poses.size() < kLeastPoses) {
    return tl::unexpected(WearableRefusal{
        fmt::format("{} still poses that differ, {} are needed; lay it down on other sides, 3 s "
                    "each",
                    poses.size(), kLeastPoses)});
  }
  std::string missing;
  for (Eigen::Index i = 0; i < 3; ++i) {
    double most = 0.0, least = 0.0;
    for (const auto& codes : poses) {
      const double force = nominal.accel_slope[i] * (codes[i] - nominal.accel_zero[i]);
      most = std::max(most, force);
      least = std::min(least, force);
    }
    const char axis = kAxes[static_cast<std::size_t>(i)];
    if (most < 0.5 * kStandardGravity) missing += fmt::format(", {} up", axis);
    if (least > -0.5 * kStandardGravity) missing += fmt::format(", {} down", axis);
  }
  if (!missing.empty()) {
    return tl::unexpected(
        WearableRefusal{fmt::format("no still pose with its {}", missing.substr(2))});
  }
  // Gauss-Newton of |k * (v - z)| - g from the nominal values, which are within some per cent.
  AxesFit fit;
  fit.zero = nominal.accel_zero;
  fit.slope = nominal.accel_slope;
  fit.parts = poses.size();
  const auto n = static_cast<Eigen::Index>(poses.size());
  Eigen::Matrix<double, Eigen::Dynamic, 6> jacobian(n, 6);
  Eigen::VectorXd residual(n);
  for (int step = 0; step < kMostSteps; ++step) {
    for (Eigen::Index i = 0; i < n; ++i) {
      const Eigen::Vector3d v = poses[static_cast<std::size_t>(i)] - fit.zero;
      const Eigen::Vector3d force = fit.slope.cwiseProduct(v);
      const Eigen::Vector3d direction = force.normalized();
      residual[i] = force.norm() - kStandardGravity;
      jacobian.row(i).head<3>() = -direction.cwiseProduct(fit.slope).transpose();
      jacobian.row(i).tail<3>() = direction.cwiseProduct(v).transpose();
    }
    const Eigen::Matrix<double, 6, 1> change = jacobian.colPivHouseholderQr().solve(residual);
    fit.zero -= change.head<3>();
    fit.slope -= change.tail<3>();
    if (change.cwiseAbs().maxCoeff() < 1e-10) break;
  }
  fit.residual = std::sqrt(residual.squaredNorm() / static_cast<double>(n));
  const auto off = (fit.slope.array() / nominal.accel_slope.array() - 1.0).abs().maxCoeff();
  if (!(off < 0.2)) {
    return tl::unexpected(WearableRefusal{
        "the still poses fit no slope within 20 % of the nominal one; was it at rest?"});
  }
  return fit;
}

tl::expected<AxesFit, WearableRefusal> gyroscope_by_turntable(std::span<const SteadyPart> parts,
                                                              const BoardCalibration& nominal,
                                                              double rate) {
  Sides sides;
  std::size_t used = 0;
  for (const SteadyPart& part : parts) {
    const Eigen::Vector3d turn = rate_of(part, nominal) / rate;
    Eigen::Index axis = 0;
    const double most = turn.cwiseAbs().maxCoeff(&axis);
    Eigen::Vector3d across = turn;
    across[axis] = 0.0;
    if (std::abs(most - 1.0) > kSameRate || across.norm() > kSameRate) continue;
    sides[static_cast<std::size_t>(axis)][turn[axis] > 0.0 ? 0 : 1].add(part.mean[axis],
                                                                        part.samples);
    ++used;
  }
  if (const std::string missing = missing_sides(sides); !missing.empty()) {
    return tl::unexpected(WearableRefusal{fmt::format(
        "not seen turning at {:.1f} rpm for 3 s with its {} (seen from above, anticlockwise; up "
        "and down change places on a table that turns clockwise)",
        rate * 30.0 / std::numbers::pi, missing)});
  }
  AxesFit fit = from_sides(sides, rate);
  fit.parts = used;
  return fit;
}

tl::expected<AxesFit, WearableRefusal> gyroscope_still(std::span<const SteadyPart> parts,
                                                       const BoardCalibration& nominal) {
  AxesFit fit;
  fit.zero.setZero();
  fit.slope = nominal.gyro_slope;
  double weight = 0.0;
  for (const SteadyPart& part : parts) {
    if (!still(part, nominal)) continue;
    fit.zero += static_cast<double>(part.samples) * part.mean.head<3>();
    weight += static_cast<double>(part.samples);
    ++fit.parts;
  }
  if (fit.parts == 0) {
    return tl::unexpected(WearableRefusal{"not seen lying still for 3 s"});
  }
  fit.zero /= weight;
  double square = 0.0;
  for (const SteadyPart& part : parts) {
    if (!still(part, nominal)) continue;
    square += fit.slope.cwiseProduct(part.mean.head<3>() - fit.zero).squaredNorm() / 3.0;
  }
  fit.residual = std::sqrt(square / static_cast<double>(fit.parts));
  return fit;
}

}  // namespace secondskin::server
