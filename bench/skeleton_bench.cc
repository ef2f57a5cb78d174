// How near do the joint angles of the marker skeleton come to Vicon's own, and to the truth? What
// does a frame cost? docs/skeleton.md quotes the output.

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
#include <random>
#include <string>
#include <vector>

#include "motion/c3d.h"
#include "motion/kinematics.h"
#include "motion/marker_file.h"
#include "motion/retarget.h"
#include "motion/rotation.h"
#include "motion/ui_prmd.h"
#include "server/markers/body_fit.h"
#include "server/markers/triangles.h"

#ifndef SECONDSKIN_SOURCE_DIR
#define SECONDSKIN_SOURCE_DIR "."
#endif

namespace {

using namespace secondskin;
using namespace secondskin::server;
namespace fs = std::filesystem;

constexpr double kDegree = std::numbers::pi / 180.0;

std::FILE* table = stdout;  // with --json the table goes to stderr

// Processor time of this thread [s]: what other processes do does not count.
double cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

double percentile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1,
                         static_cast<std::size_t>(share * static_cast<double>(values.size())))];
}

// ---------------------------------------------------------------------------------------------
// Against Vicon's angles.

// The quantities that are compared, of one side [deg].
enum Quantity {
  kHipFlexion,
  kHipAbduction,
  kHipRotation,
  kKneeFlexion,
  kAnkleFlexion,
  kShoulderElevation,
  kElbowFlexion,
  kShoulderElevationByVicon,  // about Vicon's elbow centre
  kElbowFlexionByVicon,
  kQuantities
};
constexpr std::array<const char*, kQuantities> kQuantityNames{
    "hip flexion",   "hip abduction",        "hip rotation",
    "knee flexion",  "ankle flexion",        "shoulder elevation",
    "elbow flexion", "shoulder elevation *", "elbow flexion *"};

// Plug-in Gait's axes of pelvis and thorax in ours (Vicon, "Plug-in Gait Reference Guide"), from
// where the calibration put the markers: ours stand upright with the wearer, Vicon's go by the
// markers alone. Only with the same axes is it the same angle.
struct ViconAxes {
  Eigen::Quaterniond pelvis = Eigen::Quaterniond::Identity();
  Eigen::Quaterniond thorax = Eigen::Quaterniond::Identity();

  explicit ViconAxes(const MarkerBody& body) {
    const auto at = [&](std::string_view name) -> std::optional<Eigen::Vector3d> {
      for (const Attachment& a : body.attachments) {
        if (a.name.ends_with(name)) return a.p_BM;
      }
      return std::nullopt;
    };
    const auto axes = [](const Eigen::Vector3d& y, const Eigen::Vector3d& z) {
      Eigen::Matrix3d R;
      R << y.cross(z), y, z;
      return Eigen::Quaterniond(R);
    };
    const auto la = at("LASI"), ra = at("RASI"), lp = at("LPSI"), rp = at("RPSI"), s = at("SACR");
    if (la && ra && ((lp && rp) || s)) {
      const Eigen::Vector3d back = s ? *s : Eigen::Vector3d(0.5 * (*lp + *rp));
      const Eigen::Vector3d y = (*la - *ra).normalized();
      pelvis = axes(y, (0.5 * (*la + *ra) - back).cross(y).normalized());
    }
    const auto c7 = at("C7"), t10 = at("T10"), clav = at("CLAV"), strn = at("STRN");
    if (c7 && t10 && clav && strn) {
      const Eigen::Vector3d z = (*c7 + *clav - *t10 - *strn).normalized();
      thorax = axes(z.cross(*clav + *strn - *c7 - *t10).normalized(), z);
    }
  }
};

// The elbow's centre as Plug-in Gait constructs it: half a width from the marker, square to the
// line from the shoulder, in the direction of the normal of the plane of shoulder, marker and
// wrist. In a bent arm that is inward; in a straight one the marker itself spans the plane, and the
// centre goes behind or in front of the arm.
Eigen::Vector3d vicons_elbow(const Eigen::Vector3d& shoulder, const Eigen::Vector3d& marker,
                             const Eigen::Vector3d& wrist, double half_width, bool left) {
  const Eigen::Vector3d up = shoulder - marker;
  const Eigen::Vector3d inward = (left ? -1.0 : 1.0) * up.cross(wrist - marker).normalized();
  const double d = std::min(half_width / up.norm(), 1.0);  // sine at the shoulder
  return marker + half_width * (d * up.normalized() + std::sqrt(1.0 - d * d) * inward);
}

// Ours, from a pose.
std::array<double, kQuantities> ours(const MarkerBody& body, const ViconAxes& axes,
                                     const Pose& pose, bool left) {
  std::array<Eigen::Isometry3d, kJointCount> X;
  forward_kinematics(body.skeleton, pose.p_WR, pose.q_PB, X);
  const auto side = [&](Joint j) { return left ? j : mirrored(j); };
  const auto angles = [&](Joint j) { return joint_angles(side(j), pose.q_PB[index(side(j))]); };
  const Eigen::Quaterniond& q_hip = pose.q_PB[index(side(Joint::kLeftHip))];
  const JointAngles hip = joint_angles(side(Joint::kLeftHip), axes.pelvis.conjugate() * q_hip);
  const Eigen::Vector3d trunk =
      X[index(Joint::kSpineUpper)].linear() * (axes.thorax * Eigen::Vector3d::UnitZ());
  const Eigen::Vector3d arm = X[index(side(Joint::kLeftShoulder))].linear().col(2);
  const double elevation = std::acos(std::clamp(trunk.dot(arm), -1.0, 1.0));
  const Eigen::Vector3d shoulder = X[index(side(Joint::kLeftShoulder))].translation();
  const Eigen::Vector3d wrist = X[index(side(Joint::kLeftWrist))].translation();
  Eigen::Vector3d elbow = X[index(side(Joint::kLeftElbow))].translation();
  for (const Attachment& a : body.attachments) {
    if (!a.name.ends_with(left ? "LELB" : "RELB")) continue;
    elbow =
        vicons_elbow(shoulder, X[index(a.segment)] * a.p_BM, wrist, a.p_BM.head<2>().norm(), left);
  }
  const auto between = [](const Eigen::Vector3d& u, const Eigen::Vector3d& v) {
    return std::acos(std::clamp(u.normalized().dot(v.normalized()), -1.0, 1.0));
  };
  std::array<double, kQuantities> result{hip[0],
                                         hip[1],
                                         hip[2],
                                         angles(Joint::kLeftKnee)[0],
                                         angles(Joint::kLeftAnkle)[0],
                                         elevation,
                                         angles(Joint::kLeftElbow)[0],
                                         between(trunk, shoulder - elbow),
                                         between(shoulder - elbow, elbow - wrist)};
  for (double& v : result) v /= kDegree;
  return result;
}

// Vicon's, from the three Cardan angles (YXZ) of each joint [deg]: hip adduction is positive there;
// the humerus' elevation against the trunk is acos(R_33) = acos(cos a cos b).
std::array<double, kQuantities> vicons(const Eigen::Vector3d& hip, const Eigen::Vector3d& knee,
                                       const Eigen::Vector3d& ankle,
                                       const Eigen::Vector3d& shoulder,
                                       const Eigen::Vector3d& elbow) {
  const double elevation =
      std::acos(std::cos(shoulder.x() * kDegree) * std::cos(shoulder.y() * kDegree)) / kDegree;
  return {hip.x(),   -hip.y(),  hip.z(),   knee.x(), ankle.x(),
          elevation, elbow.x(), elevation, elbow.x()};
}

// Sums of differences of one trial and quantity.
struct Difference {
  double n = 0.0, sum = 0.0, squares = 0.0;
  void add(double d) {
    d = std::remainder(d, 360.0);
    n += 1.0;
    sum += d;
    squares += d * d;
  }
  double rms() const { return n > 0.0 ? std::sqrt(squares / n) : 0.0; }
  double offset() const { return n > 0.0 ? sum / n : 0.0; }
  double rms_without_offset() const {
    return n > 0.0 ? std::sqrt(std::max(0.0, squares / n - offset() * offset())) : 0.0;
  }
};

using Differences = std::array<Difference, kQuantities>;

struct Comparison {
  std::string name;
  std::array<std::vector<Difference>, kQuantities> trials;  // one a trial and side

  void add(const Differences& differences) {
    for (std::size_t q = 0; q < kQuantities; ++q) trials[q].push_back(differences[q]);
  }
};

void print_comparisons(const std::vector<Comparison>& comparisons, nlohmann::json& json) {
  fmt::print(table, "{:<28} {:<20} {:>6} {:>10} {:>10} {:>10} {:>10}\n", "trials", "angle [deg]",
             "n", "RMS", "offset", "RMS -off.", "worst -off.");
  for (const Comparison& c : comparisons) {
    for (std::size_t q = 0; q < kQuantities; ++q) {
      double with = 0.0, without = 0.0, offset = 0.0, worst = 0.0, n = 0.0;
      for (const Difference& d : c.trials[q]) {
        if (d.n < 10.0) continue;
        with += d.rms() * d.rms();
        without += d.rms_without_offset() * d.rms_without_offset();
        offset += std::abs(d.offset());
        worst = std::max(worst, d.rms_without_offset());
        n += 1.0;
      }
      if (n == 0.0) continue;
      with = std::sqrt(with / n);
      without = std::sqrt(without / n);
      offset /= n;
      fmt::print(table, "{:<28} {:<20} {:>6.0f} {:>10.1f} {:>10.1f} {:>10.1f} {:>10.1f}\n", c.name,
                 kQuantityNames[q], n, with, offset, without, worst);
      json.push_back({{"trials", c.name},
                      {"angle", kQuantityNames[q]},
                      {"sides", n},
                      {"rms_deg", with},
                      {"mean_abs_offset_deg", offset},
                      {"rms_without_offset_deg", without},
                      {"worst_without_offset_deg", worst}});
    }
  }
}

// ---------------------------------------------------------------------------------------------
// The paper's chain, calibrated by the same body: at the frame that shows most markers.

// The joints whose segments have a triangle of two markers and a joint, or of three markers.
std::optional<TriangleSkeleton> triangles_for(const MarkerBody& body, const MarkerMotion& motion) {
  std::size_t best = 0, most = 0;
  for (std::size_t f = 0; f < motion.frames.size(); ++f) {
    const auto& visible = motion.frames[f].visible;
    const auto count = static_cast<std::size_t>(std::count(visible.begin(), visible.end(), 1));
    if (count > most) most = count, best = f;
  }
  BodyFit fit(body);
  Pose pose(kJointCount);
  (void)fit.update(motion.frames[best], 0.0, pose);
  std::array<Eigen::Isometry3d, kJointCount> X_WB;
  forward_kinematics(body.skeleton, pose.p_WR, pose.q_PB, X_WB);
  std::vector<CalibratedJoint> joints;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    CalibratedJoint joint{static_cast<Joint>(j), X_WB[j], {}};
    for (const Attachment& a : body.attachments) {
      if (index(a.segment) == j) joint.markers.push_back(a.marker);
    }
    if (joint.markers.size() < (joints.empty() ? 3 : 2)) continue;
    std::vector<CalibratedJoint> longer = joints;
    longer.push_back(std::move(joint));
    try {
      const TriangleSkeleton tried(longer, motion.frames[best]);
      joints = std::move(longer);
    } catch (const std::invalid_argument&) {
      // A segment without a triangle has no joint in the paper's chain.
    }
  }
  if (joints.empty()) return std::nullopt;
  return TriangleSkeleton(joints, motion.frames[best]);
}

struct BothChains {
  std::array<Differences, 2> fit, triangles;  // left, right
};

// `his` gives Vicon's angles of a frame and side and which of them are valid.
template <class Vicon>
BothChains compare(const MarkerMotion& motion, const BodyCalibration& calibration, Vicon his) {
  const ViconAxes axes(calibration.body);
  BodyFit fit(calibration.body);
  auto chain = triangles_for(calibration.body, motion);
  Pose pose(kJointCount), by_triangles(kJointCount);
  BothChains result;
  for (std::size_t f = 0; f < motion.frames.size(); ++f) {
    const bool tracked = fit.update(motion.frames[f], 1.0 / motion.rate_hz, pose).tracked;
    if (chain) chain->update(motion.frames[f], by_triangles);
    for (const bool left : {true, false}) {
      std::array<bool, kQuantities> valid;
      const auto vicon = his(f, left, valid);
      const auto mine = ours(calibration.body, axes, pose, left);
      const auto paper = ours(calibration.body, axes, by_triangles, left);
      for (std::size_t q = 0; q < kQuantities; ++q) {
        if (!valid[q]) continue;
        if (tracked) result.fit[left ? 0 : 1][q].add(mine[q] - vicon[q]);
        // Shoulder and elbow about Vicon's centre need the fitted body.
        if (chain && q < kShoulderElevationByVicon) {
          result.triangles[left ? 0 : 1][q].add(paper[q] - vicon[q]);
        }
      }
    }
  }
  return result;
}

BothChains compare_ui_prmd(const MarkerSet& set, const fs::path& markers,
                           const fs::path& angles_file) {
  MarkerMotion motion = read_markers(markers);
  const auto angles = read_ui_prmd_angles(angles_file);
  motion.frames.resize(std::min(motion.frames.size(), angles.size()));
  return compare(motion, calibrate_body(set, motion),
                 [&](std::size_t f, bool left, std::array<bool, kQuantities>& valid) {
                   valid.fill(true);
                   const std::size_t k = left ? 0 : 1;
                   const auto& a = angles[f];
                   return vicons(a[kUiPrmdLeftHip + k], a[kUiPrmdLeftKnee + k],
                                 a[kUiPrmdLeftAnkle + k], a[kUiPrmdLeftShoulder + k],
                                 a[kUiPrmdLeftElbow + k]);
                 });
}

// A C3D file's markers against the angles that Vicon left in it.
BothChains compare_c3d(const MarkerSet& set, const fs::path& file, const fs::path& standing) {
  const MarkerMotion motion = read_markers(file);
  const C3dFile c3d = read_c3d(file);
  std::optional<MarkerMotion> still;
  if (!standing.empty()) still = read_markers(standing);
  constexpr std::array<std::string_view, 5> kNames{"HipAngles", "KneeAngles", "AnkleAngles",
                                                   "ShoulderAngles", "ElbowAngles"};
  std::array<std::array<const C3dDerived*, 5>, 2> angles{};
  for (const C3dDerived& d : c3d.derived) {
    for (std::size_t i = 0; i < kNames.size(); ++i) {
      if (d.name.ends_with(fmt::format("L{}", kNames[i]))) angles[0][i] = &d;
      if (d.name.ends_with(fmt::format("R{}", kNames[i]))) angles[1][i] = &d;
    }
  }
  return compare(motion, calibrate_body(set, motion, still ? &*still : nullptr),
                 [&](std::size_t f, bool left, std::array<bool, kQuantities>& valid) {
                   std::array<Eigen::Vector3d, 5> a;
                   std::array<bool, 5> has{};
                   for (std::size_t i = 0; i < 5; ++i) {
                     const C3dDerived* d = angles[left ? 0 : 1][i];
                     has[i] = d != nullptr && d->valid[f] != 0;
                     a[i] = has[i] ? d->values[f] : Eigen::Vector3d::Zero();
                   }
                   constexpr std::array<std::size_t, kQuantities> kFrom{0, 0, 0, 1, 2, 3, 4, 3, 4};
                   for (std::size_t q = 0; q < kQuantities; ++q) valid[q] = has[kFrom[q]];
                   return vicons(a[0], a[1], a[2], a[3], a[4]);
                 });
}

// ---------------------------------------------------------------------------------------------
// Against the truth: markers on a body that moves by a real motion.

// Bends that a trunk or neck with one segment's markers cannot show are put where it shows them.
Motion as_seen_by_markers(Motion motion) {
  for (Pose& pose : motion.poses) {
    const auto lump = [&](Joint low, std::initializer_list<Joint> above) {
      for (const Joint j : above) {
        pose.q_PB[index(low)] = pose.q_PB[index(low)] * pose.q_PB[index(j)];
        pose.q_PB[index(j)].setIdentity();
      }
    };
    lump(Joint::kSpineLower, {Joint::kSpineMiddle, Joint::kSpineUpper});
    lump(Joint::kNeck, {Joint::kHead});
  }
  return motion;
}

struct Scene {
  MarkerMotion markers;
  std::vector<bool> hidden;  // frame-major, whether a marker was hidden
};

// Markers of a set on the wearer, each displaced from its nominal place as on people, with noise,
// markers hidden for 0.3 s on average `hidden` of the time, and wild values.
Scene place_markers(const MarkerSet& set, const Motion& truth, double noise, double hidden,
                    double wild, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  const auto vector = [&] {
    return Eigen::Vector3d(normal(random), normal(random), normal(random));
  };
  Scene scene;
  std::vector<Eigen::Vector3d> p_BM;
  std::vector<Joint> segments;
  for (const MarkerPlace& place : set.places()) {
    if (place.landmark == Landmark::kSacrum) continue;
    scene.markers.names.push_back(place.names[0]);
    const std::size_t s = index(place.segment);
    // In proportion to the segment's own length.
    const double nominal = set.nominal()[s].p_BE.norm(), own = truth.skeleton[s].p_BE.norm();
    const double scale = nominal > 0.01 && own > 0.01 ? own / nominal : 1.0;
    p_BM.push_back(scale * place.p_BM + 0.5 * place.spread.cwiseProduct(vector()));
    segments.push_back(place.segment);
  }
  scene.markers.rate_hz = truth.rate_hz;
  std::vector<bool> away(p_BM.size(), false);
  const double leave = hidden / (1.0 - hidden) / (0.3 * truth.rate_hz);
  const double come = 1.0 / (0.3 * truth.rate_hz);
  std::array<Eigen::Isometry3d, kJointCount> X_WB;
  for (const Pose& pose : truth.poses) {
    forward_kinematics(truth.skeleton, pose.p_WR, pose.q_PB, X_WB);
    MarkerFrame frame(p_BM.size());
    for (std::size_t m = 0; m < p_BM.size(); ++m) {
      if (uniform(random) < (away[m] ? come : leave)) away[m] = !away[m];
      frame.p_WM[m] = X_WB[index(segments[m])] * p_BM[m] + noise * vector();
      if (uniform(random) < wild) frame.p_WM[m] += 0.5 * vector();
      frame.visible[m] = away[m] ? 0 : 1;
    }
    scene.markers.frames.push_back(std::move(frame));
  }
  return scene;
}

struct Group {
  const char* name;
  std::vector<Joint> joints;
};
const std::vector<Group>& groups() {
  static const std::vector<Group> all{
      {"hips", {Joint::kLeftHip, Joint::kRightHip}},
      {"knees", {Joint::kLeftKnee, Joint::kRightKnee}},
      {"ankles", {Joint::kLeftAnkle, Joint::kRightAnkle}},
      {"trunk", {Joint::kSpineLower}},
      {"neck", {Joint::kNeck}},
      {"shoulders", {Joint::kLeftShoulder, Joint::kRightShoulder}},
      {"elbows", {Joint::kLeftElbow, Joint::kRightElbow}},
      {"wrists", {Joint::kLeftWrist, Joint::kRightWrist}},
  };
  return all;
}

// Errors of one joint's rotation over a trial [deg]: as it is, and after the constant turn between
// the two bodies' axes is removed.
struct RotationError {
  double rms = 0.0, without_offset = 0.0;
};
RotationError rotation_error(const std::vector<Eigen::Quaterniond>& error) {
  const Eigen::Quaterniond mean = mean_rotation(error);
  RotationError result;
  for (const Eigen::Quaterniond& q : error) {
    result.rms += rotation_vector(q).squaredNorm();
    result.without_offset += rotation_vector(mean.conjugate() * q).squaredNorm();
  }
  const double n = static_cast<double>(std::max<std::size_t>(1, error.size()));
  result.rms = std::sqrt(result.rms / n) / kDegree;
  result.without_offset = std::sqrt(result.without_offset / n) / kDegree;
  return result;
}

// Joint by joint and movement by movement: RMS, after the offset is removed, the offset, the
// truth's range.
void print_movements(const Motion& truth, const BodyCalibration& calibration,
                     const std::vector<Pose>& fitted) {
  fmt::print(table, "\nstood upright: {}, residual {:.1f} mm\n", calibration.stood_upright,
             1e3 * calibration.residual);
  for (const MarkerReport& report : calibration.markers) {
    if (!report.suspicion.empty()) fmt::print(table, "  {} {}\n", report.name, report.suspicion);
  }
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (fitted.back().confidence[j] <= 0.0F) continue;
    const auto joint = static_cast<Joint>(j);
    std::array<Difference, 3> difference;
    std::array<std::vector<double>, 3> range;
    for (std::size_t f = 0; f < fitted.size(); ++f) {
      const JointAngles a = joint_angles(joint, fitted[f].q_PB[j]),
                        b = joint_angles(joint, truth.poses[f].q_PB[j]);
      for (std::size_t m = 0; m < 3; ++m) {
        difference[m].add((a[m] - b[m]) / kDegree);
        range[m].push_back(b[m] / kDegree);
      }
    }
    fmt::print(table, "  {:<16}", joint_name(joint));
    for (std::size_t m = 0; m < 3; ++m) {
      fmt::print(table, " {:>9} {:5.1f} ({:4.1f}) {:+4.0f} in {:4.0f} to {:4.0f}",
                 kMovementNames[m], difference[m].rms(), difference[m].rms_without_offset(),
                 difference[m].offset(), percentile(range[m], 0.0), percentile(range[m], 1.0));
    }
    const Eigen::Vector3d p = 1e3 * truth.skeleton[j].p_PB,
                          q = 1e3 * calibration.body.skeleton[j].p_PB;
    fmt::print(table, "  at {:.0f} {:.0f} {:.0f}, found {:.0f} {:.0f} {:.0f}\n", p.x(), p.y(),
               p.z(), q.x(), q.y(), q.z());
  }
}

struct Condition {
  std::string name;
  double noise, hidden, wild;
};

void bench_truth(const std::vector<std::pair<std::string, MarkerSet>>& sets,
                 const std::vector<Motion>& motions, bool verbose, nlohmann::json& json) {
  const std::vector<Condition> conditions{{"clean", 0.0005, 0.0, 0.0},
                                          {"5 mm noise", 0.005, 0.0, 0.0},
                                          {"5 mm, 10 % hidden, 2 % wild", 0.005, 0.1, 0.02}};
  fmt::print(table,
             "\nJoint rotation against the truth, RMS in degrees, in brackets after a constant "
             "offset of the axes is removed\n{:<14} {:<30} {:<10}",
             "markers", "condition", "chain");
  for (const Group& group : groups()) fmt::print(table, " {:>12}", group.name);
  fmt::print(table, " {:>12}\n", "all");
  for (const auto& [name, set] : sets) {
    for (const Condition& condition : conditions) {
      for (const bool paper : {false, true}) {
        std::vector<std::array<double, 3>> sums(groups().size() + 1, {0.0, 0.0, 0.0});
        unsigned seed = 1;
        for (const Motion& truth : motions) {
          const Scene scene =
              place_markers(set, truth, condition.noise, condition.hidden, condition.wild, seed++);
          const BodyCalibration calibration = calibrate_body(set, scene.markers);
          BodyFit fit(calibration.body);
          auto chain = triangles_for(calibration.body, scene.markers);
          std::array<std::vector<Eigen::Quaterniond>, kJointCount> errors;
          std::vector<Pose> fitted;
          Pose pose(kJointCount);
          for (std::size_t f = 0; f < truth.poses.size(); ++f) {
            if (paper && chain) {
              chain->update(scene.markers.frames[f], pose);
            } else {
              (void)fit.update(scene.markers.frames[f], 1.0 / truth.rate_hz, pose);
            }
            fitted.push_back(pose);
            for (std::size_t j = 0; j < kJointCount; ++j) {
              const bool covered = std::isfinite(fit.sigma(static_cast<Joint>(j)));
              if (paper ? pose.confidence[j] <= 0.0F : !covered) continue;
              errors[j].push_back(truth.poses[f].q_PB[j].conjugate() * pose.q_PB[j]);
            }
          }
          if (verbose) print_movements(truth, calibration, fitted);
          for (std::size_t g = 0; g < groups().size(); ++g) {
            for (const Joint joint : groups()[g].joints) {
              if (errors[index(joint)].empty()) continue;
              const RotationError e = rotation_error(errors[index(joint)]);
              for (const std::size_t k : {g, groups().size()}) {
                sums[k][0] += e.rms * e.rms;
                sums[k][1] += e.without_offset * e.without_offset;
                sums[k][2] += 1.0;
              }
            }
          }
        }
        fmt::print(table, "{:<14} {:<30} {:<10}", name, condition.name,
                   paper ? "triangles" : "body fit");
        for (std::size_t g = 0; g < sums.size(); ++g) {
          if (sums[g][2] == 0.0) {
            fmt::print(table, " {:>12}", "-");
            continue;
          }
          const double rms = std::sqrt(sums[g][0] / sums[g][2]);
          const double without = std::sqrt(sums[g][1] / sums[g][2]);
          fmt::print(table, " {:>5.1f} ({:>4.1f})", rms, without);
          json.push_back({{"markers", name},
                          {"condition", condition.name},
                          {"chain", paper ? "triangles" : "body fit"},
                          {"joints", g < groups().size() ? groups()[g].name : "all"},
                          {"rms_deg", rms},
                          {"rms_without_offset_deg", without}});
        }
        fmt::print(table, "\n");
      }
    }
  }
}

// ---------------------------------------------------------------------------------------------
// Cost of a frame, and what occlusion does.

void bench_time(const std::vector<std::pair<std::string, MarkerSet>>& sets,
                const std::vector<Motion>& motions, nlohmann::json& json) {
  fmt::print(table, "\nProcessor time of a frame\n{:<14} {:>8} {:>10} {:>10} {:>10}\n", "markers",
             "number", "p50 [us]", "p99 [us]", "worst [us]");
  for (const auto& [name, set] : sets) {
    std::vector<double> times;
    std::size_t number = 0;
    unsigned seed = 1;
    for (const Motion& truth : motions) {
      const Scene scene = place_markers(set, truth, 0.005, 0.1, 0.02, seed++);
      const BodyCalibration calibration = calibrate_body(set, scene.markers);
      number = calibration.body.attachments.size();
      BodyFit fit(calibration.body);
      Pose pose(kJointCount);
      for (const MarkerFrame& frame : scene.markers.frames) {
        const double start = cpu_time();
        (void)fit.update(frame, 1.0 / truth.rate_hz, pose);
        times.push_back(1e6 * (cpu_time() - start));
      }
    }
    const double p50 = percentile(times, 0.5), p99 = percentile(times, 0.99),
                 worst = percentile(times, 1.0);
    fmt::print(table, "{:<14} {:>8} {:>10.0f} {:>10.0f} {:>10.0f}\n", name, number, p50, p99,
               worst);
    json.push_back({{"markers", name},
                    {"number", number},
                    {"p50_us", p50},
                    {"p99_us", p99},
                    {"worst_us", worst}});
  }
}

// All markers of a forearm and hand, or of a shank and foot, gone for half a second, again and
// again: how far off are the filled poses?
void bench_occlusion(const MarkerSet& set, const std::vector<Motion>& motions,
                     nlohmann::json& json) {
  fmt::print(
      table,
      "\nA limb hidden for 0.5 s in every 2 s: rotation error of the hidden joints, and their "
      "mean confidence\n{:<22} {:>10} {:>12} {:>12} {:>12} {:>12}\n",
      "hidden", "filled", "0-0.1 s", "0.1-0.25 s", "0.25-0.5 s", "when seen");
  struct Limb {
    const char* name;
    std::vector<Joint> joints;
  };
  for (const Limb& limb : {Limb{"left forearm, hand", {Joint::kLeftElbow, Joint::kLeftWrist}},
                           Limb{"left shank, foot", {Joint::kLeftKnee, Joint::kLeftAnkle}}}) {
    std::array<double, 4> squares{}, confidence{}, count{};
    double filled = 0.0, hidden_frames = 0.0;
    unsigned seed = 1;
    for (const Motion& truth : motions) {
      Scene scene = place_markers(set, truth, 0.003, 0.0, 0.0, seed++);
      const BodyCalibration calibration = calibrate_body(set, scene.markers);
      BodyFit whole(calibration.body), partly(calibration.body);
      Pose expected(kJointCount), pose(kJointCount);
      for (std::size_t f = 0; f < scene.markers.frames.size(); ++f) {
        MarkerFrame frame = scene.markers.frames[f];
        (void)whole.update(frame, 1.0 / truth.rate_hz, expected);
        const double since = std::fmod(static_cast<double>(f) / truth.rate_hz, 2.0) - 1.5;
        if (since >= 0.0) {
          for (const Attachment& a : calibration.body.attachments) {
            if (std::count(limb.joints.begin(), limb.joints.end(), a.segment) > 0) {
              frame.visible[a.marker] = 0;
            }
          }
        }
        const auto result = partly.update(frame, 1.0 / truth.rate_hz, pose);
        if (since >= 0.0) {
          hidden_frames += 1.0;
          filled += result.tracked && pose.is_valid() ? 1.0 : 0.0;
        }
        const std::size_t k = since < 0.0 ? 3 : since < 0.1 ? 0 : since < 0.25 ? 1 : 2;
        if (f < 10) continue;
        for (const Joint joint : limb.joints) {
          const double d =
              geodesic_distance(expected.q_PB[index(joint)], pose.q_PB[index(joint)]) / kDegree;
          squares[k] += d * d;
          confidence[k] += pose.confidence[index(joint)];
          count[k] += 1.0;
        }
      }
    }
    fmt::print(table, "{:<22} {:>8.1f} %", limb.name,
               100.0 * filled / std::max(1.0, hidden_frames));
    nlohmann::json entry{{"hidden", limb.name}, {"filled", filled / std::max(1.0, hidden_frames)}};
    constexpr std::array<const char*, 4> kSpans{"to_0.1_s", "to_0.25_s", "to_0.5_s", "seen"};
    for (std::size_t k = 0; k < 4; ++k) {
      const double rms = std::sqrt(squares[k] / std::max(1.0, count[k]));
      const double c = confidence[k] / std::max(1.0, count[k]);
      fmt::print(table, " {:>6.1f} {:>5.2f}", rms, c);
      entry[kSpans[k]] = {{"rms_deg", rms}, {"confidence", c}};
    }
    fmt::print(table, "\n");
    json.push_back(std::move(entry));
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"The skeleton from markers against Vicon and against the truth"};
  bool as_json = false, verbose = false;
  std::string part = "all";
  const fs::path source(SECONDSKIN_SOURCE_DIR);
  std::string data = (source / ".." / "shared" / "data").string();
  app.add_flag("--json", as_json, "Print JSON");
  app.add_flag("--verbose", verbose, "Also print each trial");
  app.add_option("--part", part, "all, vicon, truth, time or occlusion")
      ->check(CLI::IsMember({"all", "vicon", "truth", "time", "occlusion"}));
  app.add_option("--data", data, "Folder with rehab/ui-prmd and c3d");
  CLI11_PARSE(app, argc, argv);
  if (as_json) table = stderr;

  const MarkerSet set = MarkerSet::load(source / "marker_sets" / "plug_in_gait.toml");
  nlohmann::json json;
  const auto wanted = [&](std::string_view name) { return part == "all" || part == name; };
  std::vector<Comparison> fits, papers;
  for (const auto& [movement, what] : std::vector<std::pair<std::string, std::string>>{
           {"m01", "deep squat"}, {"m05", "sit to stand"}, {"m07", "shoulder abduction"}}) {
    for (const bool correct : {true, false}) {
      Comparison fit{fmt::format("{}{}", what, correct ? "" : ", incorrect"), {}};
      Comparison paper = fit;
      for (int subject = 1; subject <= 10; ++subject) {
        const std::string stem = fmt::format("{}_s{:02}_e02", movement, subject);
        const fs::path root = fs::path(data) / "rehab" / "ui-prmd";
        const std::string_view kind = correct ? "correct" : "incorrect";
        const std::string_view end = correct ? "" : "_inc";
        const fs::path markers = root / fmt::format("markers_{}", kind) /
                                 fmt::format("{}_positions{}.txt.gz", stem, end);
        const fs::path angles =
            root / fmt::format("angles_{}", kind) / fmt::format("{}_angles{}.txt.gz", stem, end);
        if (!wanted("vicon") || !fs::exists(markers) || !fs::exists(angles)) continue;
        const BothChains both = compare_ui_prmd(set, markers, angles);
        for (const std::size_t side : {0, 1}) {
          fit.add(both.fit[side]);
          paper.add(both.triangles[side]);
          if (!verbose) continue;
          fmt::print(table, "{}{} {}", stem, end, side == 0 ? "L" : "R");
          for (const Difference& d : both.fit[side]) {
            fmt::print(table, " {:5.1f} ({:+.0f})", d.rms_without_offset(), d.offset());
          }
          fmt::print(table, "\n");
        }
      }
      fits.push_back(std::move(fit));
      papers.push_back(std::move(paper));
    }
  }
  const fs::path c3d = fs::path(data) / "c3d";
  const auto add_c3d = [&](const std::string& name, const fs::path& file,
                           const fs::path& standing) {
    if (!wanted("vicon") || !fs::exists(c3d / file)) return;
    Comparison fit{name, {}}, paper{name, {}};
    const BothChains both =
        compare_c3d(set, c3d / file, standing.empty() ? fs::path() : c3d / standing);
    for (const std::size_t side : {0, 1}) {
      fit.add(both.fit[side]);
      paper.add(both.triangles[side]);
    }
    fits.push_back(std::move(fit));
    papers.push_back(std::move(paper));
  };
  add_c3d("walk, static given", "biomechzoo/HC002D06.c3d", "biomechzoo/HC002D02.c3d");
  add_c3d("walk alone", "biomechzoo/HC002D06.c3d", {});
  add_c3d("static (biomechzoo)", "biomechzoo/HC002D02.c3d", {});
  add_c3d("static (pycgm)", "pycgm/Sample_Static.c3d", {});
  if (!wanted("vicon")) {
    // Nothing to print.
  } else if (fs::exists(data)) {
    fmt::print(table,
               "Body fit against Vicon's own angles. * about the elbow centre that Plug-in Gait "
               "constructs\n");
    print_comparisons(fits, json["vicon_body_fit"]);
    fmt::print(table, "\nThe paper's triangles against Vicon's own angles\n");
    print_comparisons(papers, json["vicon_triangles"]);
  } else {
    fmt::print(table, "{}: not there, so nothing is compared with Vicon\n", data);
  }

  std::vector<Motion> motions;
  for (const char* file : {"squat/learner.bvh", "jumping_jack/learner.bvh", "low_block/motion.bvh",
                           "roundhouse_kick/motion.bvh", "stepping_punch/motion.bvh"}) {
    motions.push_back(as_seen_by_markers(
        read_canonical(source / "reference_motions" / file, source / "joint_maps")));
  }
  const std::vector<std::pair<std::string, MarkerSet>> sets{
      {"plug_in_gait", set},
      {"full_body",
       MarkerSet::from_suit(Suit::load(source / "suits" / "full_body.toml"), canonical_skeleton())},
      {"second_skin", MarkerSet::from_suit(Suit::load(source / "suits" / "second_skin.toml"),
                                           canonical_skeleton())}};
  if (wanted("truth")) bench_truth(sets, motions, verbose, json["truth"]);
  if (wanted("time")) bench_time(sets, motions, json["time"]);
  if (wanted("occlusion")) bench_occlusion(set, motions, json["occlusion"]);
  if (as_json) fmt::print("{}\n", json.dump(1));
  return 0;
}
