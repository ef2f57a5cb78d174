#include "server/wearable/csv/csv_mapping.h"

#include <map>
#include <numbers>
#include <set>

#include "motion/toml_fields.h"

namespace secondskin::server {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

template <class Value>
Value one_of(const TomlFields& fields, std::string_view field,
             const std::map<std::string, Value>& values) {
  std::vector<std::string> names;
  for (const auto& [name, value] : values) names.push_back(name);
  const auto expected = fmt::format("one of {}", fmt::join(names, ", "));
  const auto found = values.find(fields.text(field, expected));
  if (found == values.end()) fields.fail(field, expected);
  return found->second;
}

std::optional<CsvColumn> column(const toml::node* node) {
  CsvColumn column;
  if (const auto number = node->value_exact<std::int64_t>(); number && *number != 0) {
    column.sign = *number < 0 ? -1.0 : 1.0;
    column.number = static_cast<std::size_t>(std::abs(*number));
    return column;
  }
  auto name = node->value_exact<std::string>();
  if (!name || name->empty() || *name == "-") return std::nullopt;
  if (name->front() == '-') {
    column.sign = -1.0;
    name->erase(0, 1);
  }
  column.name = std::move(*name);
  return column;
}

template <std::size_t N>
std::optional<std::array<CsvColumn, N>> columns(const TomlFields& fields, std::string_view field) {
  if (!fields.has(field)) return std::nullopt;
  const auto expected =
      fmt::format("{} columns, each by name or number, with - where it is reversed", N);
  const toml::array* list = fields.table()[field].as_array();
  if (list == nullptr || list->size() != N) fields.fail(field, expected);
  std::array<CsvColumn, N> out;
  for (std::size_t i = 0; i < N; ++i) {
    const auto one = column(&(*list)[i]);
    if (!one) fields.fail(field, expected);
    out[i] = *one;
  }
  return out;
}

Eigen::Vector3d board_axis(const TomlFields& fields, std::string_view field) {
  using V = Eigen::Vector3d;
  return one_of<V>(fields, field,
                   {{"x", V::UnitX()},
                    {"y", V::UnitY()},
                    {"z", V::UnitZ()},
                    {"-x", -V::UnitX()},
                    {"-y", -V::UnitY()},
                    {"-z", -V::UnitZ()}});
}

// How the board sits: which of its axes points to the front and which up in the rest pose, or a
// quaternion.
std::optional<Eigen::Quaterniond> mounting(const TomlFields& fields) {
  if (fields.has("mounting")) {
    const auto expected = "w, x, y, z of a unit quaternion";
    const toml::array* list = fields.table()["mounting"].as_array();
    if (list == nullptr || list->size() != 4) fields.fail("mounting", expected);
    Eigen::Vector4d q;
    for (std::size_t i = 0; i < 4; ++i) {
      const auto value = (*list)[i].is_number() ? (*list)[i].value<double>() : std::nullopt;
      if (!value) fields.fail("mounting", expected);
      q[static_cast<Eigen::Index>(i)] = *value;
    }
    if (!(std::abs(q.norm() - 1.0) < 1e-2)) fields.fail("mounting", expected);
    q.normalize();
    return Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  }
  if (!fields.has("front") && !fields.has("up")) return std::nullopt;
  const Eigen::Vector3d x = board_axis(fields, "front"), z = board_axis(fields, "up");
  if (x.dot(z) != 0.0) fields.fail("up", "another axis than front");
  Eigen::Matrix3d R_BS;  // its rows are B's axes, written in S
  R_BS << x.transpose(), z.cross(x).transpose(), z.transpose();
  return Eigen::Quaterniond(R_BS);
}

}  // namespace

CsvMapping CsvMapping::load(const std::filesystem::path& file) {
  const toml::table table = parse_toml(file);
  const TomlFields fields(file, table);
  fields.allow({"name", "separator", "skip_rows", "header_rows", "time", "time_unit", "rate_hz",
                "gyro_unit", "accel_unit", "magnetic_unit", "gyro_range_deg", "accel_range",
                "board"});
  CsvMapping mapping;
  mapping.garment.name = fields.text("name");
  if (fields.has("separator")) {
    mapping.separator =
        one_of<char>(fields, "separator", {{",", ','}, {";", ';'}, {"\t", '\t'}, {" ", ' '}});
  }
  if (fields.has("skip_rows")) mapping.skip_rows = fields.whole("skip_rows", 0, 1000);
  if (fields.has("header_rows")) mapping.header_rows = fields.whole("header_rows", 0, 10);
  if (fields.has("rate_hz")) mapping.rate_hz = fields.number("rate_hz", 1.0, 10e3);
  if (fields.has("time")) {
    mapping.time = column(fields.table().get("time"));
    if (!mapping.time) fields.fail("time", "a column's name or number");
    if (fields.has("time_unit")) {
      mapping.time_unit =
          one_of<double>(fields, "time_unit",
                         {{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}, {"samples", 0.0}});
    }
  }
  if (mapping.rate_hz == 0.0 && (!mapping.time || mapping.time_unit == 0.0)) {
    fields.fail("rate_hz", "the rows' rate, as no column tells the time");
  }
  mapping.gyro_unit = one_of<double>(fields, "gyro_unit", {{"rad/s", 1.0}, {"deg/s", kDegree}});
  mapping.accel_unit =
      one_of<double>(fields, "accel_unit",
                     {{"m/s2", 1.0}, {"g", kStandardGravity}, {"mg", 1e-3 * kStandardGravity}});
  if (fields.has("magnetic_unit")) {
    mapping.magnetic_unit = one_of<double>(fields, "magnetic_unit",
                                           {{"T", 1.0}, {"uT", 1e-6}, {"G", 1e-4}, {"mG", 1e-7}});
  }
  double gyro_range = 2000.0 * kDegree, accel_range = 16.0 * kStandardGravity;
  if (fields.has("gyro_range_deg")) {
    gyro_range = fields.number("gyro_range_deg", 50.0, 1e5) * kDegree;
  }
  if (fields.has("accel_range")) accel_range = fields.number("accel_range", 10.0, 1e4);

  std::set<std::string> names;
  fields.each("board", [&](const TomlFields& entry) {
    entry.allow({"name", "segment", "along", "angle_deg", "gyro", "accel", "magnetic",
                 "orientation", "mounting", "front", "up"});
    SensorBoard board;
    board.name = entry.text("name", "a name that no other has");
    if (!names.insert(board.name).second) entry.fail("name", "a name that no other has");
    board.segment = entry.joint("segment");
    if (entry.has("along")) board.along = entry.number("along", 0.0, 1.0);
    if (entry.has("angle_deg")) board.angle = entry.number("angle_deg", -360.0, 360.0) * kDegree;
    board.gyro_range = gyro_range;
    board.accel_range = accel_range;
    mapping.garment.boards.push_back(std::move(board));
    CsvBoard where;
    where.gyro = columns<3>(entry, "gyro");
    where.accel = columns<3>(entry, "accel");
    if (!where.gyro && !where.accel) entry.fail("gyro", "columns of gyro, accel or both");
    where.magnetic = columns<3>(entry, "magnetic");
    if (where.magnetic && !fields.has("magnetic_unit")) {
      fields.fail("magnetic_unit", "the unit of the boards' magnetic columns");
    }
    where.orientation = columns<4>(entry, "orientation");
    where.q_BS = mounting(entry);
    mapping.boards.push_back(std::move(where));
  });
  mapping.garment.inertial_rate_hz = mapping.rate_hz;
  return mapping;
}

std::filesystem::path mapping_beside(const std::filesystem::path& table) {
  std::filesystem::path file = table;
  if (file.extension() == ".gz") file.replace_extension();
  return file.replace_extension(".toml");
}

}  // namespace secondskin::server
