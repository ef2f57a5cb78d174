#include <gtest/gtest.h>

#include <cstddef>
#include <vector>

#include "motion/anatomy.h"
#include "motion/kinematics.h"
#include "motion/motion.h"
#include "random_pose.h"
#include "tests/count_malloc.h"

namespace secondskin {
namespace {

#ifdef COUNTS_MALLOC

TEST(AllocationCounter, SeesEigenAllocate) {
  const long before = allocations;
  const Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(10, 10);
  EXPECT_GT(allocations, before);
  EXPECT_EQ(matrix.sum(), 0.0);
}

TEST(Kinematics, AllocateNothing) {
  const Skeleton body = canonical_skeleton();
  std::mt19937 generator(10);
  const Pose pose = random_pose(generator, body.size());
  std::vector<Eigen::Isometry3d> X_WB(body.size());
  Eigen::Matrix3Xd J(3, 3 + 3 * body.size());
  double sum = 0.0;
  const long before = allocations;
  forward_kinematics(body, pose.p_WR, pose.q_PB, X_WB);
  for (std::size_t i = 0; i < body.size(); ++i) {
    position_jacobian(body, X_WB, i, body[i].p_BE, J);
    sum += J.sum();
    orientation_jacobian(body, X_WB, i, J);
    sum += J.sum();
  }
  sum += centre_of_mass(body, X_WB).sum();
  EXPECT_EQ(allocations, before);
  EXPECT_TRUE(std::isfinite(sum));
}

TEST(PosesAndAngles, AllocateNothingOnceSized) {
  Motion motion{canonical_skeleton(), 100.0, {}};
  std::mt19937 generator(11);
  for (int i = 0; i < 10; ++i) motion.poses.push_back(random_pose(generator, kJointCount));
  Pose out;
  sample(motion, 0.0, out);
  double sum = 0.0;
  const long before = allocations;
  sample(motion, 0.0456, out);
  interpolate(motion.poses[0], motion.poses[1], 0.5, out);
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const auto joint = static_cast<Joint>(i);
    sum += joint_rotation(joint, joint_angles(joint, out.q_PB[i])).w();
    sum += right_jacobian_inverse(rotation_vector(out.q_PB[i])).sum();
  }
  sum += out.is_valid() ? 1.0 : 0.0;
  EXPECT_EQ(allocations, before);
  EXPECT_TRUE(std::isfinite(sum));
}

#else

TEST(AllocationCounter, NeedsItsOwnMalloc) {
  GTEST_SKIP() << "a sanitizer replaces malloc in this build";
}

#endif

}  // namespace
}  // namespace secondskin
