#include "motion/garment.h"

#include <set>

#include "motion/toml_fields.h"

namespace secondskin {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

void read_place(const TomlFields& fields, double& along, double& angle) {
  along = fields.number("along", 0.0, 1.0);
  angle = fields.number("angle_deg", -360.0, 360.0) * kDegree;
}

std::string new_name(const TomlFields& fields, std::set<std::string>& names) {
  std::string name = fields.text("name", "a name that no other has");
  if (!names.insert(name).second) fields.fail("name", "a name that no other has");
  return name;
}

/// A frame with z along `z` and x as near to `x` as that allows.
Eigen::Matrix3d frame(const Eigen::Vector3d& z, const Eigen::Vector3d& x) {
  Eigen::Vector3d along = x - x.dot(z) * z;
  if (along.norm() < 1e-6) along = z.unitOrthogonal();
  Eigen::Matrix3d R;
  R.col(0) = along.normalized();
  R.col(2) = z;
  R.col(1) = R.col(2).cross(R.col(0));
  return R;
}

// A place on the skin, and the segment's axis there.
struct Spot {
  SkinPlace skin;
  Eigen::Vector3d axis;
};

// Files divide trunk and shoulders in many ways, down to segments without a length, whose axis
// points anywhere: there a garment sits as on an average body of that stature. Limbs are their own.
Spot spot_on(const Skeleton& wearer, Joint segment, double along, double angle) noexcept {
  static const Skeleton average = canonical_skeleton(1.0);
  const bool trunk = segment <= Joint::kHead || segment == Joint::kLeftClavicle ||
                     segment == Joint::kRightClavicle;
  const Skeleton& body = trunk ? average : wearer;
  const Capsule capsule = segment_capsule(body, segment);
  Spot spot{skin_place(body, segment, along, angle), (capsule.p_BE - capsule.p_BA).normalized()};
  if (trunk) spot.skin.p_BS *= average_stature(wearer) / average_stature(average);
  return spot;
}

}  // namespace

Garment Garment::load(const std::filesystem::path& file) {
  const toml::table table = parse_toml(file);
  const TomlFields fields(file, table);
  fields.allow({"name", "sample_rate_hz", "slot_samples", "inertial_rate_hz", "carrier_hz",
                "gyro_range_deg", "accel_range", "board", "source"});
  Garment garment;
  garment.name = fields.text("name");
  garment.sample_rate_hz = fields.number("sample_rate_hz", 100e3, 1e6);
  garment.slot_samples = fields.whole("slot_samples", 100, 100'000);
  garment.inertial_rate_hz = fields.number("inertial_rate_hz", 1.0, 10e3);
  garment.carrier_hz = fields.number("carrier_hz", 15e3, 0.4 * garment.sample_rate_hz);
  const double gyro_range = fields.number("gyro_range_deg", 50.0, 4000.0) * kDegree;
  const double accel_range = fields.number("accel_range", 10.0, 2000.0);
  std::set<std::string> names;
  fields.each("board", [&](const TomlFields& entry) {
    entry.allow({"name", "segment", "along", "angle_deg", "turn_deg"});
    SensorBoard board;
    board.name = new_name(entry, names);
    board.segment = entry.joint("segment");
    read_place(entry, board.along, board.angle);
    if (entry.has("turn_deg")) board.turn = entry.number("turn_deg", -360.0, 360.0) * kDegree;
    board.gyro_range = gyro_range;
    board.accel_range = accel_range;
    garment.boards.push_back(std::move(board));
  });
  names.clear();
  if (!fields.has("source")) return garment;  // inertial only
  fields.each("source", [&](const TomlFields& entry) {
    entry.allow({"name", "segment", "along", "angle_deg", "standoff", "facing", "position"});
    UltrasonicSource source;
    source.name = new_name(entry, names);
    if (entry.has("facing")) {
      source.facing = entry.vector("facing", 1.0);
      if (source.facing->norm() < 1e-3) entry.fail("facing", "a direction");
      source.facing->normalize();
    }
    if (entry.has("position")) {
      source.p_W = entry.vector("position", 100.0);
      if (!source.facing) entry.fail("facing", "the direction of a source that has a position");
    } else {
      source.segment = entry.joint("segment");
      read_place(entry, source.along, source.angle);
      if (entry.has("standoff")) source.standoff = entry.number("standoff", 0.0, 0.5);
    }
    garment.sources.push_back(std::move(source));
  });
  return garment;
}

Eigen::Isometry3d board_place(const Skeleton& wearer, const SensorBoard& board) noexcept {
  const auto [place, axis] = spot_on(wearer, board.segment, board.along, board.angle);
  Eigen::Isometry3d X_BS = Eigen::Isometry3d::Identity();
  X_BS.translation() = place.p_BS;
  X_BS.linear() = frame(place.n_B, axis) *
                  Eigen::AngleAxisd(board.turn, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return X_BS;
}

Eigen::Isometry3d source_place(const Skeleton& wearer, const UltrasonicSource& source) noexcept {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  if (!source.segment) {
    X.translation() = source.p_W;
    X.linear() = frame(*source.facing, Eigen::Vector3d::UnitX());
    return X;
  }
  const auto [place, axis] = spot_on(wearer, *source.segment, source.along, source.angle);
  X.translation() = place.p_BS + source.standoff * place.n_B;
  X.linear() = frame(source.facing.value_or(place.n_B), axis);
  return X;
}

}  // namespace secondskin
