#include "motion/anatomy.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "motion/rotation.h"

namespace secondskin {
namespace {

constexpr double radians(double degrees) { return degrees * std::numbers::pi / 180.0; }
constexpr AngleRange degrees(double min, double max) { return {radians(min), radians(max)}; }
constexpr AngleRange kNone{0.0, 0.0};

// Active ranges of motion. Limbs: American Academy of Orthopaedic Surgeons, "Joint Motion" (1965),
// as tabled in Norkin & White, "Measurement of Joint Motion", app. B; knee flexion 150 and the neck
// after the AMA Guides in the same table. Elbow and knee allow 10 degrees of hyperextension (Norkin
// & White, normal variation). Shoulder adduction across the chest and axial rotation of the shank:
// Kapandji, "The Physiology of the Joints". Clavicle: Levangie & Norkin, "Joint Structure and
// Function", sternoclavicular joint.
//
// The trunk as a whole bends 80 forward, 25 back, 35 aside and turns 45 (AAOS). Bodies that are
// measured as one trunk segment carry all of it in spine_lower, so that joint's range is the whole.
// spine_middle (T7 to L1) and spine_upper (T1 to T7) have the sums of the segments' motion of White
// & Panjabi, "Clinical Biomechanics of the Spine" (1990), table 2-4, but never more than the whole.
// The neck likewise: a file may know one of neck and head, so each has the cervical spine's range.
//
// Speeds are no table's but a conservative choice for learners: 12 to 15 rad/s for shoulder, elbow,
// wrist and knee, 10 for hip and ankle, 8 and less for the trunk. Trained players' rackets take
// shoulder rotation to 11 rad/s (Reid et al. 2007, Br. J. Sports Med. 41:739); throwing and kicking
// athletes exceed all of these.
struct Side {
  double sign;  // +1 left, -1 right: mirrors rotations about x and z
};
constexpr Side kLeft{1.0};
constexpr Side kRight{-1.0};

std::array<Eigen::Vector3d, 3> midline_axes() {
  // Forward bend turns z to x; bend to the right turns z to -y; turn to the left x to y.
  return {Eigen::Vector3d::UnitY(), Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitZ()};
}

// A hanging limb: flexion lifts it forward (flexion_sign -1; the knee's +1 backward), abduction
// moves its end outward, internal rotation turns its front inward.
std::array<Eigen::Vector3d, 3> limb_axes(Side side, double flexion_sign) {
  return {flexion_sign * Eigen::Vector3d::UnitY(), side.sign * Eigen::Vector3d::UnitX(),
          -side.sign * Eigen::Vector3d::UnitZ()};
}

// The palm faces the thigh: flexion brings it inward (about x), abduction is radial deviation, the
// thumb's way, forward (about y).
std::array<Eigen::Vector3d, 3> wrist_axes(Side side) {
  return {-side.sign * Eigen::Vector3d::UnitX(), -Eigen::Vector3d::UnitY(),
          -side.sign * Eigen::Vector3d::UnitZ()};
}

using enum AngleConvention;

std::array<JointAnatomy, kJointCount> make_anatomy() {
  std::array<JointAnatomy, kJointCount> table;
  const auto set = [&](Joint joint, const JointAnatomy& anatomy) { table[index(joint)] = anatomy; };
  // The pelvis moves freely in the world; its tilt, obliquity and rotation have no limit, but
  // obliquity is read from -90 to 90.
  set(Joint::kPelvis, {"pelvis",
                       Joint::kPelvis,
                       kCardanZXY,
                       midline_axes(),
                       {degrees(-180, 180), degrees(-90, 90), degrees(-180, 180)},
                       {8, 8, 10}});
  set(Joint::kSpineLower, {"spine_lower",
                           Joint::kPelvis,
                           kCardanYXZ,
                           midline_axes(),
                           {degrees(-25, 80), degrees(-35, 35), degrees(-45, 45)},
                           {6, 5, 6}});
  set(Joint::kSpineMiddle, {"spine_middle",
                            Joint::kSpineLower,
                            kCardanYXZ,
                            midline_axes(),
                            {degrees(-20, 30), degrees(-35, 35), degrees(-23, 23)},
                            {5, 4, 5}});
  set(Joint::kSpineUpper, {"spine_upper",
                           Joint::kSpineMiddle,
                           kCardanYXZ,
                           midline_axes(),
                           {degrees(-10, 15), degrees(-34, 34), degrees(-45, 45)},
                           {4, 4, 5}});
  set(Joint::kNeck, {"neck",
                     Joint::kSpineUpper,
                     kCardanYXZ,
                     midline_axes(),
                     {degrees(-60, 50), degrees(-45, 45), degrees(-80, 80)},
                     {6, 5, 8}});
  set(Joint::kHead, {"head",
                     Joint::kNeck,
                     kCardanYXZ,
                     midline_axes(),
                     {degrees(-60, 50), degrees(-45, 45), degrees(-80, 80)},
                     {6, 5, 8}});
  for (const Side side : {kLeft, kRight}) {
    const bool left = side.sign > 0.0;
    const auto pick = [&](Joint l, Joint r) { return left ? l : r; };
    const auto name = [&](std::string_view l, std::string_view r) { return left ? l : r; };
    const Joint clavicle = pick(Joint::kLeftClavicle, Joint::kRightClavicle);
    const Joint shoulder = pick(Joint::kLeftShoulder, Joint::kRightShoulder);
    const Joint elbow = pick(Joint::kLeftElbow, Joint::kRightElbow);
    const Joint wrist = pick(Joint::kLeftWrist, Joint::kRightWrist);
    const Joint hip = pick(Joint::kLeftHip, Joint::kRightHip);
    const Joint knee = pick(Joint::kLeftKnee, Joint::kRightKnee);
    const Joint ankle = pick(Joint::kLeftAnkle, Joint::kRightAnkle);
    const Joint toes = pick(Joint::kLeftToes, Joint::kRightToes);
    // The clavicle points aside: abduction is elevation, internal rotation is protraction; turning
    // about its own length is not counted.
    set(clavicle, {name("left_clavicle", "right_clavicle"),
                   Joint::kSpineUpper,
                   kCardanYXZ,
                   limb_axes(side, -1.0),
                   {kNone, degrees(-15, 48), degrees(-30, 20)},
                   {0, 5, 5}});
    set(shoulder, {name("left_shoulder", "right_shoulder"),
                   clavicle,
                   kSwingTwist,
                   limb_axes(side, -1.0),
                   {degrees(-60, 180), degrees(-45, 180), degrees(-90, 70)},
                   {12, 12, 15}});
    // Rotation of the elbow is the forearm's: pronation positive.
    set(elbow, {name("left_elbow", "right_elbow"),
                shoulder,
                kCardanYXZ,
                limb_axes(side, -1.0),
                {degrees(-10, 150), kNone, degrees(-80, 80)},
                {15, 0, 15}});
    set(wrist, {name("left_wrist", "right_wrist"),
                elbow,
                kSwingTwist,
                wrist_axes(side),
                {degrees(-70, 80), degrees(-30, 20), kNone},
                {15, 10, 0}});
    set(hip, {name("left_hip", "right_hip"),
              Joint::kPelvis,
              kCardanYXZ,
              limb_axes(side, -1.0),
              {degrees(-30, 120), degrees(-30, 45), degrees(-45, 45)},
              {10, 8, 10}});
    set(knee, {name("left_knee", "right_knee"),
               hip,
               kCardanYXZ,
               limb_axes(side, 1.0),
               {degrees(-10, 150), kNone, degrees(-40, 30)},
               {15, 0, 8}});
    // Abduction of the ankle is eversion.
    set(ankle, {name("left_ankle", "right_ankle"),
                knee,
                kCardanYXZ,
                limb_axes(side, -1.0),
                {degrees(-50, 20), degrees(-35, 15), kNone},
                {10, 6, 0}});
    // Flexion of the toes is dorsiflexion, as of the ankle (the metatarsophalangeal joint's
    // "extension").
    set(toes, {name("left_toes", "right_toes"),
               ankle,
               kCardanYXZ,
               limb_axes(side, -1.0),
               {degrees(-45, 70), kNone, kNone},
               {10, 0, 0}});
  }
  return table;
}

// The movements in the order in which a Cardan convention turns, outermost first.
std::array<std::size_t, 3> cardan_order(AngleConvention convention) noexcept {
  constexpr std::size_t f = static_cast<std::size_t>(Movement::kFlexion);
  constexpr std::size_t a = static_cast<std::size_t>(Movement::kAbduction);
  constexpr std::size_t r = static_cast<std::size_t>(Movement::kRotation);
  if (convention == kCardanZXY) return {r, a, f};
  return {f, a, r};
}

}  // namespace

const std::array<JointAnatomy, kJointCount>& canonical_anatomy() noexcept {
  static const std::array<JointAnatomy, kJointCount> table = make_anatomy();
  return table;
}

std::string_view joint_name(Joint joint) noexcept { return canonical_anatomy()[index(joint)].name; }

std::optional<Joint> find_joint(std::string_view name) noexcept {
  for (std::size_t i = 0; i < kJointCount; ++i) {
    if (canonical_anatomy()[i].name == name) return static_cast<Joint>(i);
  }
  return std::nullopt;
}

Joint mirrored(Joint joint) noexcept {
  const std::size_t i = index(joint);
  constexpr std::size_t arms = index(Joint::kLeftClavicle);
  constexpr std::size_t legs = index(Joint::kLeftHip);
  if (i < arms) return joint;
  // Left and right arms, then left and right legs, lie in blocks of four.
  const std::size_t first = i < legs ? arms : legs;
  const std::size_t k = i - first;
  return static_cast<Joint>(first + (k + 4) % 8);
}

Skeleton canonical_skeleton(double stature) {
  if (!(stature >= 0.5 && stature <= 2.5)) {
    throw std::invalid_argument(
        fmt::format("canonical_skeleton: stature {} m, expected 0.5 to 2.5", stature));
  }
  // Heights and lengths as fractions of stature. Limbs: Drillis & Contini 1966, as in Winter,
  // "Biomechanics and Motor Control of Human Movement", fig. 4.1. Trunk landmarks: de Leva 1996,
  // J. Biomech. 29:1223, mean of both sexes' segment lengths, upward from the hips (omphalion,
  // xiphion, cervicale). Hip centres: 0.36 of the breadth between the anterior iliac spines from
  // the midline (Bell et al. 1990, J. Biomech. 23:617), that breadth 0.137.
  struct Height {
    double hip = 0.530, knee = 0.285, ankle = 0.039, toes = 0.010;
    double omphalion = 0.598, xiphion = 0.722, cervicale = 0.860;
    double head = 0.920, clavicle = 0.820, shoulder = 0.818;
  };
  constexpr Height h;
  constexpr double kSpineMiddle = 0.5 * (h.omphalion + h.xiphion);
  constexpr double kHipY = 0.050, kClavicleY = 0.015, kShoulderY = 0.129;
  constexpr double kUpperArm = 0.186, kForearm = 0.146, kHand = 0.108;
  constexpr double kFoot = 0.152, kHeel = 0.038, kBall = 0.111;  // from the heel: sole, ankle, ball

  // Masses and centres of mass: de Leva 1996, table 4, mean of the sexes. Its segments that are one
  // here and several there: the abdomen (middle trunk) is halved between spine_lower and
  // spine_middle; the neck's mass is in the head, the clavicles' in the upper trunk, the toes' in
  // the foot, which therefore have none.
  constexpr double kHeadMass = 6.81, kUpperTrunk = 15.705, kMiddleTrunk = 15.49,
                   kLowerTrunk = 11.82, kUpperArmMass = 2.63, kForearmMass = 1.50,
                   kHandMass = 0.585, kThighMass = 14.47, kShankMass = 4.57, kFootMass = 1.33;
  constexpr double kTotal =
      kHeadMass + kUpperTrunk + kMiddleTrunk + kLowerTrunk +
      2.0 * (kUpperArmMass + kForearmMass + kHandMass + kThighMass + kShankMass + kFootMass);

  std::vector<Segment> s(kJointCount);
  const auto place = [&](Joint joint, Eigen::Vector3d p_PB, Eigen::Vector3d p_BE, double mass,
                         Eigen::Vector3d p_BC) {
    Segment& segment = s[index(joint)];
    segment.name = std::string(joint_name(joint));
    if (joint != Joint::kPelvis) {
      segment.parent = index(canonical_anatomy()[index(joint)].parent);
    }
    segment.p_PB = stature * p_PB;
    segment.p_BE = stature * p_BE;
    segment.mass_fraction = mass / kTotal;
    segment.p_BC = stature * p_BC;
  };
  const auto up = [](double z) { return Eigen::Vector3d(0.0, 0.0, z); };
  // The lower trunk's centre of mass is 0.60 of the way from omphalion to the hips, the upper
  // trunk's 0.51 from cervicale to xiphion, the head's 0.49 from vertex to cervicale.
  place(Joint::kPelvis, up(0), up(h.omphalion - h.hip), kLowerTrunk,
        up(0.40 * (h.omphalion - h.hip)));
  place(Joint::kSpineLower, up(h.omphalion - h.hip), up(kSpineMiddle - h.omphalion),
        0.5 * kMiddleTrunk, up(0.5 * (kSpineMiddle - h.omphalion)));
  place(Joint::kSpineMiddle, up(kSpineMiddle - h.omphalion), up(h.xiphion - kSpineMiddle),
        0.5 * kMiddleTrunk, up(0.5 * (h.xiphion - kSpineMiddle)));
  place(Joint::kSpineUpper, up(h.xiphion - kSpineMiddle), up(h.cervicale - h.xiphion), kUpperTrunk,
        up(0.49 * (h.cervicale - h.xiphion)));
  place(Joint::kNeck, up(h.cervicale - h.xiphion), up(h.head - h.cervicale), 0.0, up(0));
  place(Joint::kHead, up(h.head - h.cervicale), up(1.0 - h.head), kHeadMass,
        up(1.0 - 0.49 * (1.0 - h.cervicale) - h.head));
  for (const double y : {1.0, -1.0}) {
    const std::size_t side = y > 0.0 ? 0 : 4;
    const auto joint = [&](Joint left) { return static_cast<Joint>(index(left) + side); };
    const Eigen::Vector3d clavicle(0, y * (kShoulderY - kClavicleY), h.shoulder - h.clavicle);
    place(joint(Joint::kLeftClavicle), {0, y * kClavicleY, h.clavicle - h.xiphion}, clavicle, 0.0,
          up(0));
    place(joint(Joint::kLeftShoulder), clavicle, up(-kUpperArm), kUpperArmMass,
          up(-0.5763 * kUpperArm));
    place(joint(Joint::kLeftElbow), up(-kUpperArm), up(-kForearm), kForearmMass,
          up(-0.4567 * kForearm));
    place(joint(Joint::kLeftWrist), up(-kForearm), up(-kHand), kHandMass, up(-0.3526 * kHand));
    place(joint(Joint::kLeftHip), {0, y * kHipY, 0}, up(h.knee - h.hip), kThighMass,
          up(0.3854 * (h.knee - h.hip)));
    place(joint(Joint::kLeftKnee), up(h.knee - h.hip), up(h.ankle - h.knee), kShankMass,
          up(0.4438 * (h.ankle - h.knee)));
    place(joint(Joint::kLeftAnkle), up(h.ankle - h.knee), {kBall - kHeel, 0, h.toes - h.ankle},
          kFootMass, {0.4215 * kFoot - kHeel, 0, -0.5 * h.ankle});
    place(joint(Joint::kLeftToes), {kBall - kHeel, 0, h.toes - h.ankle}, {kFoot - kBall, 0, 0}, 0.0,
          up(0));
  }
  return Skeleton(std::move(s));
}

bool is_canonical(const Skeleton& skeleton) noexcept {
  if (skeleton.size() != kJointCount) return false;
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const JointAnatomy& anatomy = canonical_anatomy()[i];
    if (skeleton[i].name != anatomy.name) return false;
    if (i > 0 && skeleton[i].parent != index(anatomy.parent)) return false;
  }
  return true;
}

JointAngles joint_angles(Joint joint, const Eigen::Quaterniond& q_PB) noexcept {
  const JointAnatomy& anatomy = canonical_anatomy()[index(joint)];
  const std::array<Eigen::Vector3d, 3>& axis = anatomy.axis;
  JointAngles angles{};
  if (anatomy.convention == kSwingTwist) {
    const double twist = twist_angle(q_PB, axis[2]);
    const Eigen::Quaterniond q_twist(Eigen::AngleAxisd(twist, axis[2]));
    const Eigen::Vector3d swing = rotation_vector(q_PB * q_twist.conjugate());
    return {swing.dot(axis[0]), swing.dot(axis[1]), twist};
  }
  // R = R(e1, a) R(e2, b) R(e3, c); M is R in the basis of the axes. A left-handed basis (the right
  // limbs') sees every rotation reversed, hence `hand`.
  const auto order = cardan_order(anatomy.convention);
  const Eigen::Vector3d &e1 = axis[order[0]], &e2 = axis[order[1]], &e3 = axis[order[2]];
  const double hand = e1.cross(e2).dot(e3);
  const Eigen::Matrix3d R = q_PB.toRotationMatrix();
  const Eigen::Vector3d Re1 = R * e1, Re2 = R * e2, Re3 = R * e3;
  const double m11 = e1.dot(Re1), m12 = e1.dot(Re2), m13 = e1.dot(Re3);
  const double cosine = std::hypot(m11, m12);
  angles[order[1]] = std::atan2(hand * m13, cosine);
  if (cosine > 1e-9) {
    angles[order[0]] = std::atan2(-hand * e2.dot(Re3), e3.dot(Re3));
    angles[order[2]] = std::atan2(-hand * m12, m11);
  } else {
    // Gimbal lock: only the sum of the outer angles is known; all of it is given to the first.
    angles[order[0]] = std::atan2(hand * e3.dot(Re2), e2.dot(Re2));
    angles[order[2]] = 0.0;
  }
  return angles;
}

Eigen::Quaterniond joint_rotation(Joint joint, const JointAngles& angles) noexcept {
  const JointAnatomy& anatomy = canonical_anatomy()[index(joint)];
  const std::array<Eigen::Vector3d, 3>& axis = anatomy.axis;
  if (anatomy.convention == kSwingTwist) {
    return quaternion_from(angles[0] * axis[0] + angles[1] * axis[1]) *
           quaternion_from(angles[2] * axis[2]);
  }
  const auto order = cardan_order(anatomy.convention);
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
  for (const std::size_t movement : order)
    q = q * quaternion_from(angles[movement] * axis[movement]);
  return q;
}

Pose mirrored(const Pose& canonical) {
  Pose result(kJointCount);
  result.p_WR = {canonical.p_WR.x(), -canonical.p_WR.y(), canonical.p_WR.z()};
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const std::size_t from = index(mirrored(static_cast<Joint>(i)));
    const Eigen::Quaterniond& q = canonical.q_PB[from];
    // A reflection in y keeps turns about y and reverses those about x and z.
    result.q_PB[i] = Eigen::Quaterniond(q.w(), -q.x(), q.y(), -q.z());
    result.confidence[i] = canonical.confidence[from];
  }
  return result;
}

}  // namespace secondskin
