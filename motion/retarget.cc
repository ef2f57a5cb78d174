#include "motion/retarget.h"

#include <fmt/format.h>

#include <toml++/toml.h>
#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <set>
#include <stdexcept>
#include <vector>

#include "motion/bvh.h"
#include "motion/kinematics.h"
#include "motion/rotation.h"

namespace secondskin {
namespace {

using Vector = Eigen::Vector3d;
using Rotation = Eigen::Quaterniond;

std::string lower(std::string_view text) {
  std::string result(text);
  for (char& c : result) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return result;
}

bool equals_ignoring_case(std::string_view a, std::string_view b) noexcept {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](unsigned char x, unsigned char y) {
    return std::tolower(x) == std::tolower(y);
  });
}

// "mixamorig:Hips" and "Hips" are one name: exporters put the rig's name before a colon.
std::string_view without_rig(std::string_view name) noexcept {
  const std::size_t colon = name.rfind(':');
  return colon == std::string_view::npos ? name : name.substr(colon + 1);
}

// ---------------------------------------------------------------------------------------------
// The file's body, measured in its own frame F and unit.

// Their joint for each canonical one.
using Mapping = std::array<std::optional<std::size_t>, kJointCount>;

Mapping map_joints(const JointMap& map, const Skeleton& skeleton) {
  Mapping mapping;
  for (std::size_t i = 0; i < kJointCount; ++i) {
    mapping[i] = map.find(static_cast<Joint>(i), skeleton);
  }
  return mapping;
}

constexpr std::array kLimbs{Joint::kPelvis,     Joint::kLeftHip,      Joint::kRightHip,
                            Joint::kLeftKnee,   Joint::kRightKnee,    Joint::kLeftAnkle,
                            Joint::kRightAnkle, Joint::kLeftShoulder, Joint::kRightShoulder,
                            Joint::kLeftElbow,  Joint::kRightElbow};

bool has_limbs(const Mapping& mapping) {
  return std::all_of(kLimbs.begin(), kLimbs.end(),
                     [&](Joint j) { return mapping[index(j)].has_value(); });
}

struct Body {
  const Mapping& mapping;
  std::vector<Eigen::Isometry3d> X_FS;

  Vector at(Joint j) const { return X_FS[*mapping[index(j)]].translation(); }
  Vector middle(Joint left) const { return 0.5 * (at(left) + at(mirrored(left))); }
  double distance(Joint a, Joint b) const { return (at(a) - at(b)).norm(); }
  // From between the ankles to the head, or to what is nearest to a head.
  Vector feet_to_head() const {
    for (const Joint top : {Joint::kHead, Joint::kNeck}) {
      if (mapping[index(top)]) return at(top) - middle(Joint::kLeftAnkle);
    }
    return middle(Joint::kLeftShoulder) - middle(Joint::kLeftAnkle);
  }
};

Body place(const Motion& motion, const Mapping& mapping, const Pose& pose) {
  Body body{mapping, std::vector<Eigen::Isometry3d>(motion.skeleton.size())};
  forward_kinematics(motion.skeleton, pose.p_WR, pose.q_PB, body.X_FS);
  return body;
}

// The vertical of standing people: the mean over the motion; for a motion on the floor, the rest
// pose, which always stands.
UpAxis find_up(const Motion& motion, const Mapping& mapping, const Body& rest) {
  constexpr std::size_t kFrames = 64;
  const std::size_t step = std::max<std::size_t>(1, motion.poses.size() / kFrames);
  Vector mean = Vector::Zero();
  for (std::size_t i = 0; i < motion.poses.size(); i += step) {
    mean += place(motion, mapping, motion.poses[i]).feet_to_head().normalized();
  }
  mean.normalize();
  constexpr double kUpright = 0.8;
  if (mean.y() > kUpright) return UpAxis::kY;
  if (mean.z() > kUpright) return UpAxis::kZ;
  const Vector up = rest.feet_to_head().normalized();
  if (up.y() > kUpright) return UpAxis::kY;
  if (up.z() > kUpright) return UpAxis::kZ;
  throw std::runtime_error(
      "retarget: neither the motion nor its rest pose stands upright along y or z; say which axis "
      "is "
      "up (--up y|z)");
}

// A body's stature in the file's unit from legs and trunk: hip to ankle is 0.491 and hip to
// shoulder 0.288 of stature (Drillis & Contini 1966).
double stature_in_units(const Body& rest) {
  double legs = 0.0;
  double trunk = 0.0;
  for (const bool left : {true, false}) {
    const auto side = [&](Joint j) { return left ? j : mirrored(j); };
    legs += 0.5 * (rest.distance(side(Joint::kLeftHip), side(Joint::kLeftKnee)) +
                   rest.distance(side(Joint::kLeftKnee), side(Joint::kLeftAnkle)));
  }
  trunk = (rest.middle(Joint::kLeftShoulder) - rest.middle(Joint::kLeftHip)).norm();
  if (!(legs > 0.0)) {
    throw std::runtime_error("retarget: the legs have no length, so the body has no size");
  }
  return (legs + trunk) / (0.491 + 0.288);
}

double find_unit(double stature) {
  // A unit must make a person of the stature. The CMU library's own unit, 0.45 to the inch, is
  // asked last: it also makes tall men of small people in inches.
  constexpr std::array kUnits{1.0, 0.01, 0.001, 0.0254, 0.3048};
  constexpr double kCmuUnit = 0.0254 / 0.45;
  constexpr double kShortest = 0.9, kTallest = 2.3, kUsual = 1.7;
  const auto strangeness = [&](double unit) { return std::abs(std::log(stature * unit / kUsual)); };
  const auto fits = [&](double unit) {
    return stature * unit >= kShortest && stature * unit <= kTallest;
  };
  std::optional<double> best;
  for (const double unit : kUnits) {
    if (fits(unit) && (!best || strangeness(unit) < strangeness(*best))) best = unit;
  }
  if (!best && fits(kCmuUnit)) best = kCmuUnit;
  if (!best) {
    throw std::runtime_error(fmt::format(
        "retarget: the body is {:.4g} units tall, which is no person's stature in metres, "
        "centimetres, millimetres, inches, feet or CMU units; say metres_per_unit",
        stature));
  }
  return *best;
}

// ---------------------------------------------------------------------------------------------
// The canonical body in the file's rest pose.

// The axis that v nearly points along, or v itself: rest poses are drawn along axes, and what
// deviates by a few degrees is unevenness of the measured offsets.
Vector snap(const Vector& v, double tolerance_deg) {
  Eigen::Index axis = 0;
  const Vector unit = v.normalized();
  unit.cwiseAbs().maxCoeff(&axis);
  const double cosine = std::cos(tolerance_deg * std::numbers::pi / 180.0);
  if (std::abs(unit[axis]) < cosine) return unit;
  return Vector::Unit(axis) * (unit[axis] > 0.0 ? 1.0 : -1.0);
}

// The trunk's orientation at rest: x where the body faces, y its left, z its up.
Rotation trunk_orientation(const Body& rest, const Rotation& q_WF) {
  const Vector up = snap(q_WF * rest.feet_to_head(), 30.0);
  for (const Joint pair : {Joint::kLeftHip, Joint::kLeftShoulder}) {
    const Vector across = q_WF * (rest.at(pair) - rest.at(mirrored(pair)));
    Vector forward = across.cross(up);
    if (forward.norm() < 0.5 * across.norm() || across.norm() == 0.0) continue;
    forward = snap(forward, 10.0);
    forward = (forward - forward.dot(up) * up).normalized();
    Eigen::Matrix3d R;
    R.col(0) = forward;
    R.col(1) = up.cross(forward);
    R.col(2) = up;
    return Rotation(R);
  }
  throw std::runtime_error(
      "retarget: hips and shoulders have no width at rest, so the body faces nowhere");
}

// The joint that a segment's bone runs to, where there is one.
std::optional<Joint> bone_end(Joint joint) {
  switch (joint) {
    case Joint::kSpineLower:
      return Joint::kSpineMiddle;
    case Joint::kSpineMiddle:
      return Joint::kSpineUpper;
    case Joint::kSpineUpper:
      return Joint::kNeck;
    case Joint::kNeck:
      return Joint::kHead;
    case Joint::kPelvis:
      return Joint::kSpineLower;
    case Joint::kHead:
    case Joint::kLeftWrist:
    case Joint::kRightWrist:
    case Joint::kLeftToes:
    case Joint::kRightToes:
      return std::nullopt;
    default:
      return static_cast<Joint>(index(joint) + 1);
  }
}

// Of several children's bones only one can be the segment's direction; pelvis and upper trunk carry
// limbs too and have none.
bool has_one_child(Joint joint) {
  return bone_end(joint) && joint != Joint::kPelvis && joint != Joint::kSpineUpper;
}

bool is_long_bone(Joint joint) {
  for (const Joint left : {Joint::kLeftShoulder, Joint::kLeftElbow, Joint::kLeftWrist,
                           Joint::kLeftHip, Joint::kLeftKnee}) {
    if (joint == left || joint == mirrored(left)) return true;
  }
  return false;
}

bool is_ankle(Joint joint) { return joint == Joint::kLeftAnkle || joint == Joint::kRightAnkle; }

struct RestBody {
  std::array<Vector, kJointCount> p_W;     // joint positions at rest [m]
  std::array<Rotation, kJointCount> q_WB;  // orientation of the canonical segments at rest
  std::array<std::optional<Vector>, kJointCount> end_W;  // farthest end of a leaf segment [m]
};

// The farthest end of a joint's subtree at rest, e.g. the middle finger's tip.
std::optional<Vector> farthest_end(const Skeleton& skeleton, const Body& rest, std::size_t joint) {
  const Vector origin = rest.X_FS[joint].translation();
  Vector best = origin;
  std::vector<bool> below(skeleton.size(), false);
  below[joint] = true;
  for (std::size_t i = joint; i < skeleton.size(); ++i) {
    if (i > joint) below[i] = skeleton[i].parent && below[*skeleton[i].parent];
    if (!below[i]) continue;
    for (const Vector& p :
         {Vector(rest.X_FS[i].translation()), Vector(rest.X_FS[i] * skeleton[i].p_BE)}) {
      if ((p - origin).norm() > (best - origin).norm()) best = p;
    }
  }
  if (best == origin) return std::nullopt;
  return best;
}

// Where a joint lies that the file does not have: on the way from its parent to the nearest joints
// below it that the file has, in an average body's proportions; or as in an average body.
Vector missing_position(Joint joint, const RestBody& body, const Mapping& mapping, const Body& rest,
                        const Eigen::Affine3d& X_WF, const Skeleton& average) {
  const std::size_t i = index(joint);
  const std::size_t parent = *average[i].parent;
  const double first = average[i].p_PB.norm();
  // Depth and length of the way down from `joint`, where it leads down.
  std::array<std::optional<std::size_t>, kJointCount> depth;
  std::array<double, kJointCount> length{};
  depth[i] = 0;
  length[i] = first;
  std::optional<std::size_t> nearest;
  for (std::size_t k = i + 1; k < kJointCount; ++k) {
    if (!depth[*average[k].parent]) continue;
    depth[k] = *depth[*average[k].parent] + 1;
    length[k] = length[*average[k].parent] + average[k].p_PB.norm();
    if (mapping[k] && (!nearest || *depth[k] < *depth[*nearest])) nearest = k;
  }
  if (!nearest) return body.p_W[parent] + body.q_WB[parent] * average[i].p_PB;
  const Joint target = static_cast<Joint>(*nearest);
  Vector p_F = rest.at(target);
  const bool midline = mirrored(joint) == joint;
  if (midline && mapping[index(mirrored(target))]) p_F = rest.middle(target);
  return body.p_W[parent] + first / length[*nearest] * (X_WF * p_F - body.p_W[parent]);
}

RestBody canonical_at_rest(const Motion& motion, const Mapping& mapping, const Body& rest,
                           const Rotation& q_WF, double metres, const Skeleton& average) {
  RestBody body;
  const Eigen::Affine3d X_WF = Eigen::Affine3d(q_WF) * Eigen::Scaling(metres);
  const Rotation q_trunk = trunk_orientation(rest, q_WF);
  constexpr double kLeastSlope = 8.0 * std::numbers::pi / 180.0;
  const auto downward_slope = [](const Vector& v) { return std::asin(-v.z() / v.norm()); };
  std::array<double, kJointCount> foot_pitch{};  // by the toes' joint
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const auto joint = static_cast<Joint>(i);
    const std::size_t parent = average[i].parent.value_or(0);
    body.q_WB[i] = i == 0 ? q_trunk : body.q_WB[parent];
    // Toes lie flat at rest whether or not the foot's bone does.
    body.q_WB[i] = body.q_WB[i] * Eigen::AngleAxisd(foot_pitch[i], Vector::UnitY());
    body.p_W[i] = mapping[i] ? Vector(X_WF * rest.at(joint))
                             : missing_position(joint, body, mapping, rest, X_WF, average);
    if (!mapping[i]) continue;
    // The bone at rest, in the frame of the parent's alignment.
    std::optional<Vector> end;
    if (const auto next = bone_end(joint)) {
      if (mapping[index(*next)]) end = X_WF * rest.at(*next);
    } else {
      const auto far = farthest_end(motion.skeleton, rest, *mapping[i]);
      if (far) body.end_W[i] = end = X_WF * *far;
    }
    if (!end) continue;
    const Vector bone = body.q_WB[i].conjugate() * (*end - body.p_W[i]);
    if (bone.norm() < 1e-6) continue;
    if (is_long_bone(joint)) {
      body.q_WB[i] = body.q_WB[i] * Rotation::FromTwoVectors(-Vector::UnitZ(), bone);
    } else if (is_ankle(joint) && bone.head<2>().norm() > 0.3 * bone.norm() && bone.x() > 0.0) {
      // The bone from ankle to toes slopes down over a flat sole, so only its heading is taken. A
      // file whose bone has no slope at rest has the bone for the foot's axis: over a flat sole it
      // will slope as an average foot's does. A bone along the shank says nothing about the sole.
      const double heading = std::atan2(bone.y(), bone.x());
      body.q_WB[i] = body.q_WB[i] * Eigen::AngleAxisd(heading, Vector::UnitZ());
      const double slope = downward_slope(bone);
      if (slope < kLeastSlope) {
        foot_pitch[i + 1] = downward_slope(average[i + 1].p_PB) - slope;
        body.q_WB[i] = body.q_WB[i] * Eigen::AngleAxisd(-foot_pitch[i + 1], Vector::UnitY());
      }
    }
    body.q_WB[i].normalize();
  }
  return body;
}

// Elbow and knee are hinges: where the forearm bends to is the upper arm's front, whatever twist
// the rest pose was drawn with (ISB's second option for the humerus, Wu et al. 2005). Turns the
// rest frames of both segments about their length by what the motion shows, if it shows one hinge.
void turn_to_hinge(const Motion& motion, const Mapping& mapping, const Rotation& q_WF, Joint upper,
                   double front, RestBody& body) {
  const std::size_t i = index(upper), k = i + 1;
  const Rotation q_SU = q_WF.conjugate() * body.q_WB[i], q_SL = q_WF.conjugate() * body.q_WB[k];
  constexpr std::size_t kFrames = 512;
  const std::size_t step = std::max<std::size_t>(1, motion.poses.size() / kFrames);
  std::vector<Eigen::Isometry3d> X_FS(motion.skeleton.size());
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double total = 0.0, most = 0.0;
  for (std::size_t n = 0; n < motion.poses.size(); n += step) {
    const Pose& pose = motion.poses[n];
    forward_kinematics(motion.skeleton, pose.p_WR, pose.q_PB, X_FS);
    const Rotation q_FU = Rotation(X_FS[*mapping[i]].linear()) * q_SU;
    const Rotation q_FL = Rotation(X_FS[*mapping[k]].linear()) * q_SL;
    const Eigen::Vector2d bend = (q_FU.conjugate() * (q_FL * -Vector::UnitZ())).head<2>() * front;
    sum += bend;
    total += bend.norm();
    most = std::max(most, bend.norm());
  }
  constexpr double kEnoughBend = 0.35;  // sine of 20 degrees
  constexpr double kOneHinge = 0.95;    // length of the mean direction; 1 for a perfect hinge
  constexpr double kLargestTwist = 60.0 * std::numbers::pi / 180.0;
  const double twist = std::atan2(sum.y(), sum.x());
  if (most < kEnoughBend || sum.norm() < kOneHinge * total || std::abs(twist) > kLargestTwist)
    return;
  const Eigen::AngleAxisd turn(twist, Vector::UnitZ());
  body.q_WB[i] = (body.q_WB[i] * turn).normalized();
  body.q_WB[k] = (body.q_WB[k] * turn).normalized();
}

Skeleton make_skeleton(const RestBody& body, const Skeleton& average) {
  std::vector<Segment> segments = average.segments();
  for (std::size_t i = 0; i < kJointCount; ++i) {
    Segment& s = segments[i];
    if (s.parent) {
      s.p_PB = body.q_WB[*s.parent].conjugate() * (body.p_W[i] - body.p_W[*s.parent]);
    }
  }
  for (std::size_t i = 0; i < kJointCount; ++i) {
    Segment& s = segments[i];
    const double usual = s.p_BE.norm();
    if (const auto next = bone_end(static_cast<Joint>(i))) {
      s.p_BE = segments[index(*next)].p_PB;
    } else if (body.end_W[i]) {
      s.p_BE = body.q_WB[i].conjugate() * (*body.end_W[i] - body.p_W[i]);
    }
    // The centre of mass moves with the bone's length, unless the file's bone is a stump that
    // stands for no segment.
    const double length = s.p_BE.norm();
    if (length > 0.3 * usual) s.p_BC *= length / usual;
  }
  return Skeleton(std::move(segments));
}

void require_canonical(const Skeleton& skeleton, std::string_view what) {
  if (!is_canonical(skeleton)) {
    throw std::invalid_argument(fmt::format("{}: not a canonical skeleton", what));
  }
}

}  // namespace

// ---------------------------------------------------------------------------------------------

JointMap JointMap::load(const std::filesystem::path& file) {
  const auto fail = [&](const toml::source_region& where, std::string_view what) {
    throw std::runtime_error(fmt::format("{}:{}: {}", file.string(), where.begin.line, what));
  };
  toml::table table;
  try {
    table = toml::parse_file(file.string());
  } catch (const toml::parse_error& error) {
    fail(error.source(), error.description());
  }
  const toml::table* joints = table["joints"].as_table();
  if (joints == nullptr) fail(table.source(), "no table [joints]");
  JointMap map;
  map.name_ = file.stem().string();
  std::map<std::string, toml::source_region> used;
  for (const auto& [key, value] : *joints) {
    const auto joint = find_joint(key.str());
    if (!joint) {
      fail(key.source(), fmt::format("\"{}\" is no canonical joint", key.str()));
    }
    std::vector<std::string>& names = map.names_[*joint];
    const auto add = [&](const toml::node& node) {
      const auto name = node.value<std::string>();
      if (!node.is_string() || name->empty()) {
        fail(node.source(),
             fmt::format("{}: expected a joint's name or a list of names", key.str()));
      }
      const auto [first, is_new] = used.emplace(lower(*name), node.source());
      if (!is_new) {
        // A table comes in alphabetical order: the second in the file is the one to show.
        const auto& other = first->second;
        fail(other.begin.line > node.source().begin.line ? other : node.source(),
             fmt::format("\"{}\" is named twice", *name));
      }
      names.push_back(*name);
    };
    if (const toml::array* list = value.as_array()) {
      for (const toml::node& node : *list) add(node);
    } else {
      add(value);
    }
  }
  return map;
}

std::optional<std::size_t> JointMap::find(Joint joint, const Skeleton& skeleton) const noexcept {
  const auto names = names_.find(joint);
  if (names == names_.end()) return std::nullopt;
  for (const std::string& name : names->second) {
    for (std::size_t i = 0; i < skeleton.size(); ++i) {
      if (equals_ignoring_case(without_rig(skeleton[i].name), name)) return i;
    }
  }
  return std::nullopt;
}

JointMap JointMap::choose(const std::filesystem::path& folder, const Skeleton& skeleton) {
  std::error_code error;
  std::set<std::filesystem::path> files;  // sorted, so that the choice does not depend on the disk
  for (std::filesystem::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().extension() == ".toml") files.insert(it->path());
  }
  if (files.empty()) {
    throw std::runtime_error(fmt::format("{}: found no joint maps (*.toml)", folder.string()));
  }
  std::optional<JointMap> best;
  std::ptrdiff_t most = 0;
  for (const auto& file : files) {
    JointMap map = load(file);
    const Mapping mapping = map_joints(map, skeleton);
    const std::ptrdiff_t count =
        std::count_if(mapping.begin(), mapping.end(), [](const auto& m) { return m.has_value(); });
    if (has_limbs(mapping) && count > most) {
      most = count;
      best = std::move(map);
    }
  }
  if (!best) {
    std::string names;
    for (const Segment& s : skeleton.segments()) names += (names.empty() ? "" : ", ") + s.name;
    throw std::runtime_error(fmt::format(
        "no joint map in {} names the pelvis and both sides' hip, knee, ankle, shoulder "
        "and elbow of this skeleton: {}",
        folder.string(), names));
  }
  return *std::move(best);
}

Retargeted to_canonical(const Motion& motion, const JointMap& map, const RetargetOptions& options) {
  const Mapping mapping = map_joints(map, motion.skeleton);
  if (!has_limbs(mapping)) {
    throw std::runtime_error(fmt::format(
        "retarget: joint map \"{}\" does not name the skeleton's pelvis and limbs; choose "
        "another map",
        map.name()));
  }
  const Body rest = place(motion, mapping, Pose(motion.skeleton.size()));
  const double units = stature_in_units(rest);
  const double metres = options.metres_per_unit ? *options.metres_per_unit : find_unit(units);
  const double stature = units * metres;
  if (!(stature >= 0.5 && stature <= 2.5)) {
    throw std::runtime_error(fmt::format(
        "retarget: metres_per_unit {} makes the body {:.4g} m tall, expected 0.5 to 2.5 m", metres,
        stature));
  }
  const UpAxis up = options.up ? *options.up : find_up(motion, mapping, rest);
  // y up: x_W = z_F, y_W = x_F, z_W = y_F.
  Eigen::Matrix3d R_WF = Eigen::Matrix3d::Identity();
  if (up == UpAxis::kY) R_WF << 0, 0, 1, 1, 0, 0, 0, 1, 0;
  const Rotation q_WF(R_WF);

  const Skeleton average = canonical_skeleton(stature);
  RestBody body = canonical_at_rest(motion, mapping, rest, q_WF, metres, average);
  for (const Joint shoulder : {Joint::kLeftShoulder, Joint::kRightShoulder}) {
    turn_to_hinge(motion, mapping, q_WF, shoulder, 1.0, body);
  }
  for (const Joint hip : {Joint::kLeftHip, Joint::kRightHip}) {
    turn_to_hinge(motion, mapping, q_WF, hip, -1.0, body);
  }

  // A file's segment has the file's axes at rest, so q_SB = q_WF^-1 * q_WB(rest).
  std::array<Rotation, kJointCount> q_SB;
  for (std::size_t i = 0; i < kJointCount; ++i) q_SB[i] = q_WF.conjugate() * body.q_WB[i];

  // Segments that hold further joints of the file, which bend: they follow the line to their end.
  std::array<std::optional<std::size_t>, kJointCount> bends;
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const auto joint = static_cast<Joint>(i);
    if (!has_one_child(joint) || !mapping[i]) continue;
    const std::size_t end = index(*bone_end(joint));
    if (!mapping[end] || motion.skeleton[*mapping[end]].parent == mapping[i]) continue;
    if ((body.p_W[end] - body.p_W[i]).norm() > 0.01) bends[i] = end;
  }

  Retargeted result{Motion{make_skeleton(body, average), motion.rate_hz, {}}, up, metres};
  result.motion.poses.reserve(motion.poses.size());
  std::vector<Eigen::Isometry3d> X_FS(motion.skeleton.size());
  std::array<Rotation, kJointCount> q_WB;
  for (const Pose& from : motion.poses) {
    forward_kinematics(motion.skeleton, from.p_WR, from.q_PB, X_FS);
    Pose pose(kJointCount);
    pose.p_WR = q_WF * (metres * X_FS[*mapping[index(Joint::kPelvis)]].translation());
    for (std::size_t i = 0; i < kJointCount; ++i) {
      const auto parent = average[i].parent;
      if (!mapping[i]) {
        q_WB[i] = q_WB[*parent];
        pose.confidence[i] = 0.0F;
        continue;
      }
      const Eigen::Isometry3d& X = X_FS[*mapping[i]];
      q_WB[i] = q_WF * Rotation(X.linear()) * q_SB[i];
      if (bends[i]) {
        const Vector bone_W = q_WF * (X_FS[*mapping[*bends[i]]].translation() - X.translation());
        const Vector bone_B = q_WB[i].conjugate() * bone_W;
        q_WB[i] =
            q_WB[i] * Rotation::FromTwoVectors(result.motion.skeleton[*bends[i]].p_PB, bone_B);
      }
      pose.confidence[i] = from.confidence[*mapping[i]];
    }
    // The wrist does not turn about the forearm: that is pronation, and the forearm's.
    for (const Joint elbow : {Joint::kLeftElbow, Joint::kRightElbow}) {
      const std::size_t forearm = index(elbow), hand = forearm + 1;
      if (!mapping[hand]) continue;
      const double twist = twist_angle(q_WB[forearm].conjugate() * q_WB[hand], Vector::UnitZ());
      q_WB[forearm] = q_WB[forearm] * Eigen::AngleAxisd(twist, Vector::UnitZ());
    }
    for (std::size_t i = 0; i < kJointCount; ++i) {
      const auto parent = average[i].parent;
      pose.q_PB[i] = (parent ? q_WB[*parent].conjugate() * q_WB[i] : q_WB[i]).normalized();
    }
    result.motion.poses.push_back(std::move(pose));
  }
  return result;
}

Motion fit_to(const Motion& canonical, const Skeleton& target) {
  require_canonical(canonical.skeleton, "fit_to: the motion");
  require_canonical(target, "fit_to: the target");
  // Height of the pelvis over the ankles in the rest pose.
  const auto leg = [](const Skeleton& s) {
    double height = 0.0;
    for (const Joint hip : {Joint::kLeftHip, Joint::kRightHip}) {
      for (std::size_t k = 0; k < 3; ++k) height -= 0.5 * s[index(hip) + k].p_PB.z();
    }
    return height;
  };
  const double from = leg(canonical.skeleton), to = leg(target);
  if (!(from > 0.0) || !(to > 0.0)) {
    throw std::invalid_argument("fit_to: legs that do not reach below the pelvis");
  }
  Motion result{target, canonical.rate_hz, canonical.poses};
  for (Pose& pose : result.poses) pose.p_WR *= to / from;
  return result;
}

Motion read_canonical(const std::filesystem::path& file, const std::filesystem::path& joint_maps,
                      const RetargetOptions& options) {
  const std::string extension = lower(file.extension().string());
  if (extension != ".bvh") {
    throw std::runtime_error(fmt::format("{}: found a file name ending in \"{}\", expected .bvh",
                                         file.string(), extension));
  }
  const BvhFile bvh = read_bvh(file);
  try {
    const JointMap map = JointMap::choose(joint_maps, bvh.motion.skeleton);
    return to_canonical(bvh.motion, map, options).motion;
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(fmt::format("{}: {}", file.string(), error.what()));
  }
}

}  // namespace secondskin
