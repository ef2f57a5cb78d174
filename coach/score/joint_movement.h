#pragma once

#include <array>
#include <numbers>
#include <optional>
#include <vector>

#include "coach/reference.h"

/// How each joint moved during a repetition, apart from how far off it was: how late, how smoothly,
/// how far. Sums only, so that a frame costs the same however long the repetition gets.
/// docs/scoring.md, section 3.
namespace secondskin::coach {

/// What the reference's joints do, each written as rotation vectors from its mean orientation.
struct ReferenceCurves {
  std::array<Eigen::Quaterniond, kJointCount> q_PM;             ///< mean orientation M
  std::vector<std::array<Eigen::Vector3d, kJointCount>> curve;  ///< by frame, in M [rad]
  std::array<Eigen::Vector3d, kJointCount> axis;  ///< about which it turns most, unit length, in M
  std::array<double, kJointCount> range{};        ///< about that axis [rad]
};

ReferenceCurves reference_curves(const Motion& motion);

class JointMovement {
 public:
  /// Less than this is no movement that could be late or jerky.
  static constexpr double kLeastRange = 10.0 * std::numbers::pi / 180.0;  // [rad]

  explicit JointMovement(const Reference& reference);

  /// Takes a joint's share of each frame.
  /// @param time            since the repetition began [s]; a step back counts as none
  /// @param reference_time  aligned [s]
  void update(double time, double reference_time, const Pose& pose) noexcept;

  /// By how much the joint is behind the rest of the learner's body, compared with the expert's, in
  /// the reference's time [s], within kLongestLag; empty where learner or expert hardly move it.
  std::optional<double> timing_error(std::size_t joint) const noexcept;

  /// Spectral arc length of the joint's angular speed: SPARC, Balasubramanian et al. 2015, J.
  /// NeuroEng. Rehab. 12:112, section "Estimating SPARC"; negative, the nearer to 0 the smoother.
  /// Empty where the learner hardly moves it.
  std::optional<double> smoothness(std::size_t joint) const noexcept;

  /// The learner's range about the axis about which the expert turns the joint most [rad]; where
  /// the expert hardly moves it, the greatest of those about the mean orientation's own axes.
  double range(std::size_t joint) const noexcept;
  double reference_range(std::size_t joint) const noexcept { return curves_.range[joint]; }

  void clear() noexcept;

  static constexpr double kLongestLag = 0.5;  ///< [s]

 private:
  // Lags are tried in steps of two reference frames; the best is refined by a parabola.
  static constexpr int kLagStep = 2;
  static constexpr int kLags = static_cast<int>(kLongestLag * kReferenceRate) / kLagStep;
  static constexpr std::size_t kLagCount = 2 * kLags + 1;
  static constexpr std::size_t kBins = 501;  // of the speed's spectrum
  static constexpr double kBinWidth = 0.02;  // [Hz]; 500 of them: 10 Hz

  void add_to_lags(std::size_t joint, double frame, const Eigen::Vector3d& x) noexcept;
  void add_to_spectrum(double time) noexcept;

  ReferenceCurves curves_;
  struct Joint {
    double count = 0.0, square = 0.0;
    // Along the main axis and along M's own.
    Eigen::Vector4d least = Eigen::Vector4d::Zero(), greatest = Eigen::Vector4d::Zero();
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  };
  struct Lag {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();  // of the reference's curve
    double square = 0.0, product = 0.0;
  };
  std::array<Joint, kJointCount> joints_{};
  std::array<std::array<Lag, kLagCount>, kJointCount> lags_{};
  std::vector<float> real_, imaginary_;  // kBins a joint
  std::array<float, kBins> cosine_{}, sine_{};
  std::array<double, kJointCount> turned_{};  // in this frame [rad]
  Pose last_;
  std::array<bool, kJointCount> have_last_{};
  double last_time_ = 0.0;
  bool begun_ = false;
};

}  // namespace secondskin::coach
