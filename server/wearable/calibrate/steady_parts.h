#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "wire/inertial_code.h"

/// Where a board's inertial codes stay the same: it lies still, or turns at a constant rate.
namespace secondskin::server {

using CodeVector = Eigen::Matrix<double, 6, 1>;  ///< gyroscope x, y, z, accelerometer x, y, z

struct SteadyPart {
  CodeVector mean;          ///< [code]
  std::size_t samples = 0;  ///< that it is the mean of
};

/// Collects one board's codes. Samples that are lost may just be left out.
class SteadyParts {
 public:
  static constexpr std::size_t kWindow = 70;  ///< samples: half a second at 140 Hz
  /// Means of neighbouring windows differ by no more than this. The rounding that the delta
  /// modulation carries on leaves 1/70 of it to a window's mean. [code]
  static constexpr double kSteady = 0.08;
  /// A steady part has so many windows; the first and the last of them, in which the board was
  /// laid down and taken up, are not used.
  static constexpr std::size_t kLeastWindows = 5;

  void add(const wire::InertialCode& code);
  /// The parts so far, the one that goes on too. Codes at an end of the range end a part.
  std::vector<SteadyPart> parts() const;
  std::size_t samples() const noexcept { return kWindow * windows_.size() + in_window_; }

 private:
  std::vector<CodeVector> windows_;  ///< means
  std::vector<bool> saturated_;      ///< by window
  CodeVector sum_ = CodeVector::Zero();
  std::size_t in_window_ = 0;
  bool hit_end_ = false;
};

}  // namespace secondskin::server
