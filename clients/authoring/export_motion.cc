#include "clients/authoring/export_motion.h"

#include <fmt/format.h>

#include <cerrno>
#include <fstream>
#include <iterator>
#include <optional>
#include <stdexcept>
#include <system_error>

#include "bus/pose_messages.h"
#include "bus/topics.h"
#include "motion/angle_csv.h"
#include "motion/bvh.h"
#include "motion/kinematics.h"
#include "motion/marker_file.h"
#include "motion/whole_file.h"
#include "recording/mcap_writer.h"
#include "server/open_source.h"

namespace secondskin::authoring {

namespace fs = std::filesystem;
namespace msg = bus::msg;

namespace {

// Row by row, for a live source may go on for hours; under another name until it is whole.
void export_csv(server::PoseSource& source, const fs::path& file) {
  fs::path part = file;
  part += ".part";
  const auto refuse = [&](int error) {
    throw std::system_error(error, std::generic_category(),
                            fmt::format("{}: cannot be written", file.string()));
  };
  std::ofstream out(part, std::ios::binary);
  if (!out) refuse(errno);
  write_angle_csv_header(out);
  std::optional<std::int64_t> start;
  server::for_each_pose(source, [&](const StampedPose& pose) {
    if (!start) start = pose.stamp_ns;
    if (!pose.pose.is_valid()) return;
    write_angle_csv_row(out, static_cast<double>(pose.stamp_ns - *start) * 1e-9, pose.pose);
  });
  out.close();
  if (!out) {
    const int error = errno;
    fs::remove(part);
    refuse(error);
  }
  fs::rename(part, file);
}

void export_mcap(server::PoseSource& source, const std::string& name, const fs::path& idl_path,
                 const fs::path& file) {
  const std::string idl = read_whole_file(idl_path);
  recording::McapWriter writer(file);
  const auto bodies = writer.add_channel("/secondskin/export/skeleton",
                                         "secondskin_msgs::msg::SkeletonDefinition", "omgidl", idl);
  const auto poses = writer.add_channel("/secondskin/export/pose",
                                        "secondskin_msgs::msg::SkeletonPose", "omgidl", idl);
  msg::SkeletonPose message;
  std::uint32_t id = 0, count = 0;
  server::for_each_pose(source, [&](const StampedPose& pose) {
    if (count == 0) {
      msg::SkeletonDefinition body;
      bus::to_message(source.skeleton(), name, source.rate_hz(), body);
      id = body.skeleton_id();
      body.publish_ns(pose.stamp_ns);
      writer.write(bodies, 1, pose.stamp_ns, pose.stamp_ns, bus::encode(body));
    }
    bus::to_message(pose, id, message);
    message.header().publish_ns(pose.stamp_ns);
    writer.write(poses, ++count, pose.stamp_ns, pose.stamp_ns, bus::encode(message));
  });
  writer.close();
}

}  // namespace

MarkerMotion joint_centres(const Motion& motion) {
  MarkerMotion out;
  out.rate_hz = motion.rate_hz;
  std::vector<Eigen::Isometry3d> X_WB(motion.skeleton.size());
  for (const auto& segment : motion.skeleton.segments()) out.names.push_back(segment.name);
  for (const Pose& pose : motion.poses) {
    forward_kinematics(motion.skeleton, pose.p_WR, pose.q_PB, X_WB);
    MarkerFrame frame(X_WB.size());
    for (std::size_t j = 0; j < X_WB.size(); ++j) {
      frame.p_WM[j] = X_WB[j].translation();
      frame.visible[j] = pose.confidence[j] > 0.0F ? 1 : 0;
    }
    out.frames.push_back(std::move(frame));
  }
  return out;
}

void export_source(server::PoseSource& source, const std::string& name, const fs::path& idl,
                   const fs::path& to) {
  const std::string kind = to.extension().string();
  if (kind == ".csv") {
    export_csv(source, to);
  } else if (kind == ".bvh") {
    write_bvh(server::read_all(source), to);
  } else if (kind == ".mcap") {
    export_mcap(source, name, idl, to);
  } else if (kind == ".c3d" || kind == ".trc") {
    write_markers(joint_centres(server::read_all(source)), to);
  } else {
    throw std::runtime_error(
        fmt::format("{}: expected .bvh, .csv, .c3d, .trc or .mcap", to.filename().string()));
  }
}

}  // namespace secondskin::authoring
