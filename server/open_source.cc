#include "server/open_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "server/replay/motion_source.h"
#include "server/replay/recording_source.h"

namespace secondskin::server {

std::unique_ptr<PoseSource> open_source(const std::string& source,
                                        const std::filesystem::path& joint_maps,
                                        const RetargetOptions& retarget) {
  constexpr std::string_view kReplay = "replay:";
  std::string path = source;
  if (path.starts_with(kReplay)) path.erase(0, kReplay.size());
  const std::filesystem::path file(path);
  if (!std::filesystem::exists(file)) {
    throw std::runtime_error(fmt::format(
        "source '{}': no such file; expected replay:FILE or FILE, with .bvh or .mcap", source));
  }
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (extension == ".mcap") return std::make_unique<RecordingSource>(file);
  if (extension == ".bvh") {
    return std::make_unique<MotionSource>(read_canonical(file, joint_maps, retarget));
  }
  throw std::runtime_error(fmt::format(
      "source '{}': files of type '{}' are not known; expected .bvh or .mcap", source, extension));
}

Motion read_all(PoseSource& source) {
  std::vector<StampedPose> poses;
  StampedPose pose;
  while (source.next(pose)) {
    const bool later = poses.empty() || pose.stamp_ns > poses.back().stamp_ns;
    if (later && pose.pose.is_valid()) poses.push_back(pose);
  }
  if (poses.empty()) throw std::runtime_error("the source holds no valid pose");
  Motion motion{source.skeleton(), source.rate_hz(), {}};
  const double step_ns = 1e9 / motion.rate_hz;
  const auto end = static_cast<double>(poses.back().stamp_ns - poses.front().stamp_ns);
  std::size_t i = 0;
  Pose at(source.skeleton().size());
  for (double t = 0.0; t <= end + 0.5 * step_ns; t += step_ns) {
    const auto stamp = [&](std::size_t k) {
      return static_cast<double>(poses[k].stamp_ns - poses.front().stamp_ns);
    };
    while (i + 1 < poses.size() && stamp(i + 1) <= t) ++i;
    if (i + 1 < poses.size()) {
      interpolate(poses[i].pose, poses[i + 1].pose, (t - stamp(i)) / (stamp(i + 1) - stamp(i)), at);
      motion.poses.push_back(at);
    } else {
      motion.poses.push_back(poses[i].pose);
    }
  }
  return motion;
}

}  // namespace secondskin::server
