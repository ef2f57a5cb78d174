#pragma once

#include <cstdint>
#include <vector>

#include "server/wearable/estimate/body_filter.h"
#include "server/wearable/estimate/body_state.h"

/// A fixed-interval smoother for recordings of reference performances: what the filter learnt later
/// goes back to what it said earlier (Rauch, Tung and Striebel 1965, AIAA J. 3:1445), on the error
/// state:
///   C = P F^T (F P F^T + Q)^-1,   x_s(k) = x(k) (+) C (x_s(k+1) (-) f(x(k))).
///
/// The whole covariance of a body's state is 0.5 MB a sample, 70 MB a second. Each joint (rotation,
/// rate, acceleration) and the root's place are smoothed by their own 9 x 9 blocks instead, which
/// leaves out what joints tell of each other after the filter has used it: 10 kB a sample, 1.4 MB a
/// second at 140 Hz. Offsets and mountings stay as the filter had them at the time.
namespace secondskin::server {

class Smoother {
 public:
  /// @param settings  the filter's
  explicit Smoother(const FilterSettings& settings) : settings_(settings) {}

  /// Takes the filter's estimate after an inertial measurement; stamps that do not grow are left
  /// out.
  void add(const BodyFilter& filter);

  /// The smoothed pose of each estimate taken, in order. Confidences are the filter's.
  std::vector<StampedPose> smooth() const;

  std::size_t size() const noexcept { return samples_.size(); }

 private:
  using Block = Eigen::Matrix<float, 9, 9>;
  struct Place {
    Eigen::Vector3d p, v, a;
  };
  struct Sample {
    std::int64_t stamp_ns;
    std::vector<GroupState> joints;
    std::vector<Block> joint_covariance;
    Place root;
    Block root_covariance;
    Pose pose;
  };
  FilterSettings settings_;
  std::array<int, kJointCount> joint_of_{};
  std::vector<Sample> samples_;
};

}  // namespace secondskin::server
