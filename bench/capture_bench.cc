// How right is the pose that the optical system gives, and what does it cost? A body that moves by
// a real motion wears a suit between virtual projectors; bytes of its tags go through the whole
// chain to a pose, next to the truth. docs/benchmarks.md quotes the output.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "motion/kinematics.h"
#include "motion/retarget.h"
#include "motion/rotation.h"
#include "server/markers/body_fit.h"
#include "server/optical/calibrate/wand_calibration.h"
#include "server/optical/tag_merger.h"
#include "server/optical/track/body_tracker.h"
#include "sim/optical/calibration_scenes.h"
#include "sim/optical/suit_scene.h"
#include "sim/optical/virtual_tags.h"

namespace {

using namespace secondskin;
using namespace secondskin::server;
namespace fs = std::filesystem;
using nlohmann::json;

// Processor time of this thread [s]: what other processes do does not count.
double cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

double quantile(std::vector<double> v, double q) {
  if (v.empty()) return NAN;
  const auto i = static_cast<std::size_t>(q * static_cast<double>(v.size() - 1));
  std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(i), v.end());
  return v[i];
}

double rms(const std::vector<double>& v) {
  double sum = 0.0;
  for (const double x : v) sum += x * x;
  return v.empty() ? NAN : std::sqrt(sum / static_cast<double>(v.size()));
}

constexpr double deg(double radians) { return radians * 180.0 / std::numbers::pi; }

ProjectorRig true_rig() {
  ProjectorRig rig;
  for (const auto& projector : sim::second_skin_rig())
    rig.projectors.push_back({{projector.matrix()}});
  return rig;
}

ProjectorRig wand_rig() {
  sim::WandScene scene;
  sim::VirtualRig rig(sim::second_skin_rig(), scene, {}, 5);
  WandSession session(
      Wand{scene.options().p_TD.size() == 3
               ? std::vector<Eigen::Vector3d>{{0, 0, 0.03}, {0.5, 0, 0.03}, {0, 0.35, 0.03}}
               : scene.options().p_TD},
      16);
  ProjectorFrame frame(scene.detectors(), 16);
  const double period = 1e-9 * static_cast<double>(wire::cycle_ns(16));
  for (std::uint64_t c = 0; static_cast<double>(c) * period < scene.rests_from() + 4.0; ++c) {
    rig.cycle(static_cast<double>(c) * period, frame.values);
    frame.cycle = c;
    frame.stamp_ns = static_cast<std::int64_t>(c) * wire::cycle_ns(16);
    session.add(frame);
  }
  const auto result = session.solve();
  if (!result) throw std::runtime_error(result.error().text);
  return result->rig;
}

// The bytes of a suit over a motion, as they come out of VirtualTags.
struct Recording {
  std::vector<std::size_t> sizes;
  std::vector<std::vector<std::uint8_t>> bytes;  // a tag
};

Recording record(sim::SuitScene& scene, const Suit& suit, double seconds, double wild) {
  sim::OpticalNoise noise;
  noise.wild_share = wild;
  sim::VirtualRig rig(sim::second_skin_rig(), scene, noise, 3);
  Recording out{sim::tag_sizes(suit), {}};
  out.bytes.resize(out.sizes.size());
  sim::VirtualTags tags(rig, out.sizes, {}, 4);
  const auto cycles = static_cast<std::size_t>(seconds / tags.cycle_time());
  for (std::size_t c = 0; c < cycles; ++c) {
    tags.cycle(static_cast<double>(c) * tags.cycle_time(),
               [&](std::size_t tag, double, std::span<const std::uint8_t> bytes) {
                 out.bytes[tag].insert(out.bytes[tag].end(), bytes.begin(), bytes.end());
               });
  }
  return out;
}

// Frames out of the bytes, and what that took.
std::vector<ProjectorFrame> decode(const Recording& recording, double& cpu) {
  const double start = cpu_time();
  TagMerger merger(recording.sizes, 16, TagMerger::Clock::kCount);
  std::vector<wire::TagDecoder> decoders;
  for (const auto size : recording.sizes) decoders.emplace_back(wire::TagFormat{size, 16, false});
  std::vector<std::size_t> at(recording.sizes.size(), 0);
  std::vector<ProjectorFrame> frames;
  ProjectorFrame frame;
  while (const auto tag = merger.wanted()) {
    const auto sink = [&](const wire::TagSet& set) { merger.add(*tag, set); };
    const auto& bytes = recording.bytes[*tag];
    const std::size_t n = std::min<std::size_t>(512, bytes.size() - at[*tag]);
    decoders[*tag].feed({bytes.data() + at[*tag], n}, 0, sink);
    at[*tag] += n;
    if (n == 0) {
      decoders[*tag].finish(sink);
      merger.finish(*tag);
    }
    while (merger.next(0, frame)) frames.push_back(frame);
  }
  cpu = cpu_time() - start;
  return frames;
}

// Angles are compared between the segments that wear detectors: the trunk as one (a suit does not
// tell its joints apart, nor the shoulder's from the clavicle's).
constexpr Joint kTrunk = Joint::kSpineUpper;
Joint base_of(Joint joint) {
  switch (joint) {
    case kTrunk:
      return Joint::kPelvis;
    case Joint::kHead:
    case Joint::kLeftShoulder:
    case Joint::kRightShoulder:
      return kTrunk;
    default:
      return canonical_anatomy()[index(joint)].parent;
  }
}

// Every compared joint's rotation, of the pelvis in the world.
std::array<std::optional<Eigen::Quaterniond>, kJointCount> rotations(const Skeleton& skeleton,
                                                                     const Pose& pose) {
  std::array<Eigen::Isometry3d, kJointCount> X_WB;
  forward_kinematics(skeleton, pose.p_WR, pose.q_PB, X_WB);
  std::array<std::optional<Eigen::Quaterniond>, kJointCount> out;
  for (const Joint joint :
       {Joint::kPelvis, kTrunk, Joint::kHead, Joint::kLeftShoulder, Joint::kLeftElbow,
        Joint::kLeftWrist, Joint::kRightShoulder, Joint::kRightElbow, Joint::kRightWrist,
        Joint::kLeftHip, Joint::kLeftKnee, Joint::kLeftAnkle, Joint::kRightHip, Joint::kRightKnee,
        Joint::kRightAnkle}) {
    const Eigen::Quaterniond q_WB(X_WB[index(joint)].linear());
    const Eigen::Quaterniond q_WA(X_WB[index(base_of(joint))].linear());
    out[index(joint)] = joint == Joint::kPelvis ? q_WB : q_WA.conjugate() * q_WB;
  }
  return out;
}

struct Outcome {
  std::vector<double> joint_errors[kJointCount];  // geodesic [rad]
  std::vector<double> angle_errors[kJointCount];  // of the anatomical flexion [rad]
  std::vector<double> root_errors;                // [m]
  std::vector<double> track_cpu, fit_cpu;         // a frame [s]
  double decode_cpu = 0.0;
  std::size_t frames = 0, visible = 0, markers = 0;
};

Outcome run(sim::SuitScene& scene, const std::vector<ProjectorFrame>& frames,
            const ProjectorRig& rig, const MarkerBody& body,
            std::span<const std::size_t> segment_of) {
  const std::size_t detectors = segment_of.size();
  Outcome out;
  BodyTracker tracker(rig, segment_of);
  BodyFit fit(body);
  MarkerFrame points(detectors);
  Pose pose(kJointCount), truth(kJointCount);
  const double period = 1e-9 * static_cast<double>(wire::cycle_ns(16));
  std::uint64_t last = 0;
  for (const auto& frame : frames) {
    const double t0 = cpu_time();
    tracker.update(frame, points);
    const double t1 = cpu_time();
    const auto result = fit.update(points, static_cast<double>(frame.cycle - last) * period, pose);
    out.track_cpu.push_back(t1 - t0);
    out.fit_cpu.push_back(cpu_time() - t1);
    last = frame.cycle;
    ++out.frames;
    out.markers += points.visible.size();
    for (const auto v : points.visible) out.visible += v;
    if (!result.tracked || frame.cycle < 60) continue;
    scene.pose_at(static_cast<double>(frame.cycle + 1) * period, truth);
    out.root_errors.push_back((pose.p_WR - truth.p_WR).norm());
    const auto given = rotations(body.skeleton, pose), right = rotations(scene.skeleton(), truth);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const auto joint = static_cast<Joint>(j);
      const bool worn = std::any_of(body.attachments.begin(), body.attachments.end(),
                                    [&](const auto& a) { return a.segment == joint; });
      if (!given[j] || !worn) continue;
      out.joint_errors[j].push_back(geodesic_distance(*given[j], *right[j]));
      const double error = joint_angles(joint, *given[j])[0] - joint_angles(joint, *right[j])[0];
      out.angle_errors[j].push_back(std::remainder(error, 2.0 * std::numbers::pi));
    }
  }
  return out;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Pose error and cost of the whole optical chain, against truth."};
  fs::path data = fs::path(SECONDSKIN_SOURCE_DIR) / ".." / "shared" / "data";
  std::string suit_name = "full_body";
  double seconds = 60.0;
  double wild = 0.02;
  bool as_json = false;
  app.add_option("--data", data, "the folder with bvh/cmu");
  app.add_option("--suit", suit_name, "under suits/")->capture_default_str();
  app.add_option("--seconds", seconds, "how long each motion goes on")->capture_default_str();
  app.add_option("--wild", wild, "share of wild values")->capture_default_str();
  app.add_flag("--json", as_json, "as JSON");
  CLI11_PARSE(app, argc, argv);
  const fs::path source = SECONDSKIN_SOURCE_DIR;
  const Suit suit = Suit::load(source / "suits" / (suit_name + ".toml"));
  std::vector<std::size_t> segment_of;
  for (const auto& detector : suit.detectors) segment_of.push_back(index(detector.segment));
  std::vector<fs::path> files;
  for (const char* name : {"135_05_gedanbarai", "135_07_mawashigeri", "13_26", "14_14"}) {
    const fs::path file = data / "bvh" / "cmu" / (std::string(name) + ".bvh");
    if (fs::exists(file)) files.push_back(file);
  }
  if (files.empty()) {
    fmt::print(stderr, "{} has no recordings; using the shipped ones\n", data.string());
    for (const char* name : {"low_block", "squat"}) {
      files.push_back(source / "reference_motions" / name / "learner.bvh");
    }
  }
  // Everybody is asked to stand upright for a moment before the calibration's movement.
  const auto with_standing = [](Motion motion) {
    Pose standing(kJointCount);
    standing.p_WR = motion.poses.front().p_WR;
    double lowest = 0.0;
    for (const Joint joint : {Joint::kLeftHip, Joint::kLeftKnee, Joint::kLeftAnkle}) {
      lowest += motion.skeleton[index(joint)].p_PB.z();
    }
    standing.p_WR.z() = -lowest + 0.08;
    standing.confidence = motion.poses.front().confidence;
    const auto still = static_cast<std::size_t>(2.0 * motion.rate_hz);
    std::vector<Pose> poses(still, standing);
    const auto blend = static_cast<std::size_t>(motion.rate_hz);
    for (std::size_t i = 0; i < blend; ++i) {
      Pose between(kJointCount);
      const double u = static_cast<double>(i) / static_cast<double>(blend);
      interpolate(standing, motion.poses.front(), u * u * (3.0 - 2.0 * u), between);
      poses.push_back(std::move(between));
    }
    poses.insert(poses.end(), motion.poses.begin(), motion.poses.end());
    motion.poses = std::move(poses);
    return motion;
  };
  const ProjectorRig truth = true_rig();
  const ProjectorRig waved = wand_rig();
  json all = json::array();
  for (const auto& file : files) {
    sim::SuitScene scene(sim::recentred(with_standing(read_canonical(file, source / "joint_maps"))),
                         suit, sim::AtEnd::kThereAndBack);
    const auto recording = record(scene, suit, seconds, wild);
    double decode_cpu = 0.0;
    const auto frames = decode(recording, decode_cpu);
    MarkerBody known{scene.skeleton(), {}};
    for (std::size_t d = 0; d < suit.detectors.size(); ++d) {
      known.attachments.push_back(
          {d, suit.detectors[d].name, scene.segment(d), scene.place(d).p_BS, 0.008});
    }
    // The wearer as calibration finds them: from the first third of the movement.
    MarkerMotion trial;
    trial.rate_hz = 62.5;
    for (const auto& detector : suit.detectors) trial.names.push_back(detector.name);
    {
      BodyTracker tracker(waved, segment_of);
      MarkerFrame points(suit.detectors.size());
      for (std::size_t i = 0; i < frames.size() / 3; ++i) {
        tracker.update(frames[i], points);
        trial.frames.push_back(points);
      }
    }
    const auto found = calibrate_body(MarkerSet::from_suit(suit, canonical_skeleton()), trial);
    for (const bool calibrated : {false, true}) {
      auto out = run(scene, frames, calibrated ? waved : truth, calibrated ? found.body : known,
                     segment_of);
      out.decode_cpu = decode_cpu;
      json joints = json::object();
      std::vector<double> every;
      for (std::size_t j = 0; j < kJointCount; ++j) {
        if (out.joint_errors[j].empty()) continue;
        every.insert(every.end(), out.joint_errors[j].begin(), out.joint_errors[j].end());
        joints[std::string(joint_name(static_cast<Joint>(j)))] = {
            {"rotation_rms_deg", deg(rms(out.joint_errors[j]))},
            {"flexion_rms_deg", deg(rms(out.angle_errors[j]))}};
      }
      const double frame_cpu = quantile(out.track_cpu, 0.5) + quantile(out.fit_cpu, 0.5) +
                               decode_cpu / static_cast<double>(frames.size());
      all.push_back(
          {{"motion", file.stem().string() == "learner" ? file.parent_path().filename().string()
                                                        : file.stem().string()},
           {"calibration", calibrated ? "wand, own movement" : "true"},
           {"frames", out.frames},
           {"points_given", static_cast<double>(out.visible) / static_cast<double>(out.markers)},
           {"root_rms_mm", 1e3 * rms(out.root_errors)},
           {"rotation_rms_deg", deg(rms(every))},
           {"joints", joints},
           {"track_us_p50", 1e6 * quantile(out.track_cpu, 0.5)},
           {"track_us_p99", 1e6 * quantile(out.track_cpu, 0.99)},
           {"fit_us_p50", 1e6 * quantile(out.fit_cpu, 0.5)},
           {"fit_us_p99", 1e6 * quantile(out.fit_cpu, 0.99)},
           {"share_of_core", frame_cpu * 62.5}});
    }
  }
  if (as_json) {
    fmt::print("{}\n", all.dump(2));
    return 0;
  }
  fmt::print("suit {}: {} detectors, 16 projectors, {:.0f} % wild values, {:.0f} s each\n\n",
             suit_name, suit.detectors.size(), 100.0 * wild, seconds);
  fmt::print("{:<20} {:<20} {:>7} {:>10} {:>12} {:>15} {:>15} {:>7}\n", "motion", "calibration",
             "points", "root [mm]", "joints [deg]", "track p50/99 us", "fit p50/99 us", "core");
  for (const auto& row : all) {
    fmt::print(
        "{:<20} {:<20} {:5.1f} % {:10.1f} {:12.2f} {:7.0f} {:7.0f} {:7.0f} {:7.0f} {:5.1f} %\n",
        row["motion"].get<std::string>(), row["calibration"].get<std::string>(),
        100.0 * row["points_given"].get<double>(), row["root_rms_mm"].get<double>(),
        row["rotation_rms_deg"].get<double>(), row["track_us_p50"].get<double>(),
        row["track_us_p99"].get<double>(), row["fit_us_p50"].get<double>(),
        row["fit_us_p99"].get<double>(), 100.0 * row["share_of_core"].get<double>());
  }
  fmt::print("\nRMS rotation error by joint [deg] (flexion alone in brackets)\n{:<16}", "joint");
  for (const auto& row : all) {
    fmt::print(" {:>18.18}",
               row["motion"].get<std::string>() + (row["calibration"] == "true" ? " t" : " w"));
  }
  fmt::print("\n");
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const std::string name(joint_name(static_cast<Joint>(j)));
    if (!all.front()["joints"].contains(name)) continue;
    fmt::print("{:<16}", name);
    for (const auto& row : all) {
      if (!row["joints"].contains(name)) {
        fmt::print(" {:>18}", "-");
        continue;
      }
      fmt::print(" {:>18}", fmt::format("{:.2f} ({:.2f})",
                                        row["joints"][name]["rotation_rms_deg"].get<double>(),
                                        row["joints"][name]["flexion_rms_deg"].get<double>()));
    }
    fmt::print("\n");
  }
  return 0;
}
