#include "sim/wearable/worn_garment.h"

#include <gtest/gtest.h>

#include "motion/kinematics.h"
#include "motion/retarget.h"
#include "motion/rotation.h"
#include "sim/wearable/acoustics.h"
#include "sim/wearable/simulated_measurements.h"

namespace secondskin::sim {
namespace {

const std::filesystem::path kSource = SECONDSKIN_SOURCE_DIR;

Motion motion_of(const char* reference) {
  return read_canonical(kSource / "reference_motions" / reference / "motion.bvh",
                        kSource / "joint_maps");
}

Garment practical() { return Garment::load(kSource / "garments/practical.toml"); }

TEST(WornGarment, GyroscopesIntegrateToTheBoardsOrientation) {
  const WornGarment worn(motion_of("roundhouse_kick"), practical(), WornErrors{}, 1);
  std::vector<BoardTruth> now(worn.garment().boards.size()), middle = now;
  worn.boards_at(0.0, now);
  std::vector<Eigen::Quaterniond> q_WS;
  for (const BoardTruth& board : now) q_WS.emplace_back(board.X_WS.linear());
  constexpr double kStep = 1e-3;
  double time = 0.0;
  for (; time < worn.duration() - kStep; time += kStep) {
    worn.boards_at(time + 0.5 * kStep, middle);
    for (std::size_t i = 0; i < q_WS.size(); ++i) {
      q_WS[i] = q_WS[i] * quaternion_from(kStep * middle[i].gyro);
    }
  }
  worn.boards_at(time, now);
  for (std::size_t i = 0; i < q_WS.size(); ++i) {
    EXPECT_LT(geodesic_distance(q_WS[i], Eigen::Quaterniond(now[i].X_WS.linear())), 2e-4)
        << worn.garment().boards[i].name;
  }
}

TEST(WornGarment, AccelerometersIntegrateTwiceToTheBoardsPlace) {
  const WornGarment worn(motion_of("roundhouse_kick"), practical(), WornErrors{}, 2);
  std::vector<BoardTruth> now(worn.garment().boards.size()), middle = now;
  worn.boards_at(0.0, now);
  std::vector<Eigen::Vector3d> p, v;
  for (const BoardTruth& board : now) {
    p.push_back(board.X_WS.translation());
    v.push_back(board.v);
  }
  constexpr double kStep = 1e-3;
  double time = 0.0;
  for (; time < worn.duration() - kStep; time += kStep) {
    worn.boards_at(time + 0.5 * kStep, middle);
    for (std::size_t i = 0; i < p.size(); ++i) {
      const Eigen::Vector3d a =
          middle[i].X_WS.linear() * middle[i].accel - kStandardGravity * Eigen::Vector3d::UnitZ();
      p[i] += kStep * v[i] + 0.5 * kStep * kStep * a;
      v[i] += kStep * a;
    }
  }
  worn.boards_at(time, now);
  for (std::size_t i = 0; i < p.size(); ++i) {
    EXPECT_LT((p[i] - now[i].X_WS.translation()).norm(), 1e-3) << worn.garment().boards[i].name;
    EXPECT_LT((v[i] - now[i].v).norm(), 1e-3) << worn.garment().boards[i].name;
  }
}

TEST(WornGarment, FeelsGravityUpwardsAndNothingElseAtRest) {
  const WornGarment worn(motion_of("squat"), practical(), WornErrors{}, 3);
  std::vector<BoardTruth> boards(worn.garment().boards.size());
  for (const double time : {0.0, 1.0, 2.0}) {
    worn.boards_at(time, boards);
    for (const BoardTruth& board : boards) {
      EXPECT_LT(
          (board.X_WS.linear() * board.accel - Eigen::Vector3d(0, 0, kStandardGravity)).norm(),
          0.05);
      EXPECT_LT(board.gyro.norm(), 0.01);
    }
  }
}

TEST(WornGarment, BeginsInTheCanonicalRestPoseOnTheFloor) {
  const WornGarment worn(motion_of("stepping_punch"), practical(), WornErrors{}, 4);
  Pose pose;
  worn.pose_at(1.0, pose);
  EXPECT_LT(pose.p_WR.head<2>().norm(), 1e-9);
  for (const Eigen::Quaterniond& q : pose.q_PB) EXPECT_LT(q.vec().norm(), 1e-9);
  std::array<Eigen::Isometry3d, kJointCount> X_WB;
  forward_kinematics(worn.skeleton(), pose.p_WR, pose.q_PB, X_WB);
  EXPECT_NEAR((X_WB[index(Joint::kLeftToes)] * worn.skeleton()[index(Joint::kLeftToes)].p_BE).z(),
              worn.floor(), 0.03);
}

TEST(WornGarment, AccelerationsAreThoseOfABody) {
  double most = 0.0;
  for (const char* name : {"roundhouse_kick", "stepping_punch", "squat"}) {
    const WornGarment worn(motion_of(name), practical(), WornErrors::none(), 1);
    std::vector<BoardTruth> boards(worn.garment().boards.size());
    double peak = 0.0;
    for (double time = 0.0; time < worn.duration(); time += 1.0 / 140.0) {
      worn.boards_at(time, boards);
      for (const BoardTruth& board : boards) peak = std::max(peak, board.accel.norm());
    }
    RecordProperty(name, std::to_string(peak));
    most = std::max(most, peak);
  }
  EXPECT_LT(most, 250.0);  // a kick's foot; mocap's raw second differences exceed 1000
}

TEST(WornGarment, SoftTissueHasTheGivenSizeWhileTheBodyMoves) {
  const Motion motion = motion_of("jumping_jack");
  WornErrors tissue = WornErrors::none();
  tissue.tissue_place = 0.005;
  tissue.tissue_angle = 0.0524;
  const WornGarment rigid(motion, practical(), WornErrors::none(), 5);
  double place = 0.0, angle = 0.0, count = 0.0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    const WornGarment worn(motion, practical(), tissue, seed);
    std::vector<BoardTruth> boards(worn.garment().boards.size()), bones = boards;
    for (double time = worn.rest(); time < worn.duration(); time += 0.05) {
      worn.boards_at(time, boards);
      rigid.boards_at(time, bones);
      for (std::size_t i = 0; i < boards.size(); ++i) {
        place += (boards[i].X_WS.translation() - bones[i].X_WS.translation()).squaredNorm();
        const double turn = geodesic_distance(Eigen::Quaterniond(boards[i].X_WS.linear()),
                                              Eigen::Quaterniond(bones[i].X_WS.linear()));
        angle += turn * turn;
        count += 1.0;
      }
    }
    worn.boards_at(1.0, boards);
    rigid.boards_at(1.0, bones);
    EXPECT_LT((boards[9].X_WS.translation() - bones[9].X_WS.translation()).norm(), 5e-4);
  }
  EXPECT_NEAR(std::sqrt(place / count), 0.005, 0.0005);
  EXPECT_NEAR(std::sqrt(angle / count), 0.0524, 0.005);
}

}  // namespace
}  // namespace secondskin::sim
