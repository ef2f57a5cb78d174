#include "motion/angle_csv.h"

#include <fmt/format.h>

#include <iterator>
#include <ostream>

namespace secondskin {
namespace {

bool has_movement(const JointAnatomy& joint, std::size_t movement) {
  return joint.range[movement].min < joint.range[movement].max;
}

constexpr double degrees(double radians) { return radians * 180.0 / std::numbers::pi; }

}  // namespace

void write_angle_csv_header(std::ostream& out) {
  fmt::memory_buffer line;
  auto at = std::back_inserter(line);
  fmt::format_to(at, "t,root_x,root_y,root_z");
  for (const JointAnatomy& joint : canonical_anatomy()) {
    for (std::size_t m = 0; m < kMovementNames.size(); ++m) {
      if (has_movement(joint, m)) fmt::format_to(at, ",{}_{}_deg", joint.name, kMovementNames[m]);
    }
  }
  line.push_back('\n');
  out.write(line.data(), static_cast<std::streamsize>(line.size()));
}

void write_angle_csv_row(std::ostream& out, double time, const Pose& canonical) {
  fmt::memory_buffer line;
  auto at = std::back_inserter(line);
  const Eigen::Vector3d& p = canonical.p_WR;
  fmt::format_to(at, "{:.6f},{:.6f},{:.6f},{:.6f}", time, p.x(), p.y(), p.z());
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const JointAnatomy& joint = canonical_anatomy()[i];
    const bool measured = canonical.confidence[i] > 0.0F;
    const JointAngles angles = joint_angles(static_cast<Joint>(i), canonical.q_PB[i]);
    for (std::size_t m = 0; m < kMovementNames.size(); ++m) {
      if (!has_movement(joint, m)) continue;
      line.push_back(',');
      if (measured) fmt::format_to(at, "{:.4f}", degrees(angles[m]));
    }
  }
  line.push_back('\n');
  out.write(line.data(), static_cast<std::streamsize>(line.size()));
}

}  // namespace secondskin
