#include <bus/topics.h>
#include <coach/reference.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <numbers>

int main(int argc, char** argv) {
  using namespace secondskin;
  if (argc != 2) return 2;
  const std::filesystem::path data = argv[1];
  const auto squat =
      coach::load_reference(data / "reference_motions" / "squat", data / "joint_maps");
  double deepest = 0.0;
  for (const Pose& pose : squat.motion.poses) {
    deepest =
        std::max(deepest, joint_angles(Joint::kLeftKnee, pose.q_PB[index(Joint::kLeftKnee)])[0]);
  }
  std::printf("%s: left knee bends to %.0f degrees\n", bus::full_topic_name("anna", "pose").c_str(),
              deepest * 180.0 / std::numbers::pi);
}
