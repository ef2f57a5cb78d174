#include "motion/xsens_body.h"

namespace secondskin {

void to_xsens(std::span<const TPoseSegment> joints, std::span<TPoseSegment> xsens) noexcept {
  for (std::size_t j = 0; j < kJointCount; ++j) xsens[kXsensSegmentOf[j]] = joints[j];
  const auto& lower = joints[index(Joint::kSpineLower)];
  const auto& middle = joints[index(Joint::kSpineMiddle)];
  xsens[kXsensL3] = {0.5 * (lower.p_WN + middle.p_WN), lower.q_WN};
}

void from_xsens(std::span<const TPoseSegment> xsens, std::span<TPoseSegment> joints) noexcept {
  for (std::size_t j = 0; j < kJointCount; ++j) joints[j] = xsens[kXsensSegmentOf[j]];
}

Skeleton xsens_skeleton(std::span<const TPoseSegment> xsens) {
  const auto offset = [&](std::size_t parent, std::size_t child) -> Eigen::Vector3d {
    return xsens[parent].q_WN.conjugate() * (xsens[child].p_WN - xsens[parent].p_WN);
  };
  std::array<Eigen::Vector3d, kJointCount> p_MN;
  p_MN[0].setZero();
  for (std::size_t j = 1; j < kJointCount; ++j) {
    const std::size_t parent = kXsensSegmentOf[index(canonical_anatomy()[j].parent)];
    p_MN[j] = offset(parent, kXsensSegmentOf[j]);
  }
  // Unbent, L3's part of the way lies on L5's.
  constexpr std::size_t kL5 = kXsensSegmentOf[index(Joint::kSpineLower)];
  constexpr std::size_t kT12 = kXsensSegmentOf[index(Joint::kSpineMiddle)];
  p_MN[index(Joint::kSpineMiddle)] = offset(kL5, kXsensL3) + offset(kXsensL3, kT12);
  return skeleton_from_t_pose(p_MN);
}

}  // namespace secondskin
