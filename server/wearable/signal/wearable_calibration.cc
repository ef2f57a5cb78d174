#include "server/wearable/signal/wearable_calibration.h"

#include <algorithm>

#include "motion/toml_fields.h"
#include "motion/whole_file.h"

namespace secondskin::server {
namespace {

// Wide enough for any sensor and amplifier, narrow enough to find a slip of the pen.
constexpr double kMostOffset = 500.0, kMostStrength = 1e12, kMostZero = 64.0, kMostSlope = 1e3;

std::string written(const Eigen::Vector3d& v) {
  return fmt::format("[{:.7g}, {:.7g}, {:.7g}]", v.x(), v.y(), v.z());
}

template <class Things>
std::size_t place_of(const Things& things, const TomlFields& in, std::vector<bool>& given) {
  const std::string name = in.text("name");
  const auto found = std::find_if(things.begin(), things.end(),
                                  [&](const auto& thing) { return thing.name == name; });
  if (found == things.end()) in.fail("name", "a name of the garment's");
  const auto i = static_cast<std::size_t>(found - things.begin());
  if (given[i]) in.fail("name", "each name once");
  given[i] = true;
  return i;
}

Eigen::Vector3d triple(const wire::InertialCode& code, std::size_t first) noexcept {
  return {static_cast<double>(code.values[first]), static_cast<double>(code.values[first + 1]),
          static_cast<double>(code.values[first + 2])};
}

Eigen::Vector3d slope(const TomlFields& in, std::string_view field) {
  const Eigen::Vector3d value = in.vector(field, kMostSlope);
  if (!(value.array().abs() > 1e-9).all()) in.fail(field, "three numbers other than 0");
  return value;
}

}  // namespace

WearableCalibration WearableCalibration::nominal(const Garment& garment) {
  WearableCalibration calibration;
  calibration.garment = garment.name;
  calibration.sources.resize(garment.sources.size());
  for (const auto& board : garment.boards) {
    const Eigen::Vector3d middle = Eigen::Vector3d::Constant(0.5 * wire::kValueCodes);
    const Eigen::Vector3d step = Eigen::Vector3d::Constant(2.0 / wire::kValueCodes);
    calibration.boards.push_back(
        {middle, middle, step * board.gyro_range, step * board.accel_range});
  }
  return calibration;
}

WearableCalibration WearableCalibration::load(const std::filesystem::path& file,
                                              const Garment& garment) {
  const toml::table table = parse_toml(file);
  const TomlFields top(file, table);
  top.allow({"garment", "temperature", "source", "board"});
  WearableCalibration calibration = nominal(garment);
  if (top.text("garment") != garment.name) {
    top.fail("garment", fmt::format("\"{}\", the garment that is worn", garment.name));
  }
  calibration.temperature = top.number("temperature", -40.0, 60.0);
  if (top.has("source")) {
    std::vector<bool> given(garment.sources.size());
    top.each("source", [&](const TomlFields& in) {
      in.allow({"name", "offset", "strength"});
      auto& source = calibration.sources[place_of(garment.sources, in, given)];
      source.offset = in.number("offset", -kMostOffset, kMostOffset);
      source.strength = in.number("strength", 1e-3, kMostStrength);
    });
  }
  if (top.has("board")) {
    std::vector<bool> given(garment.boards.size());
    top.each("board", [&](const TomlFields& in) {
      in.allow({"name", "gyro_zero", "gyro_slope", "accel_zero", "accel_slope"});
      auto& board = calibration.boards[place_of(garment.boards, in, given)];
      board.gyro_zero = in.vector("gyro_zero", kMostZero);
      board.gyro_slope = slope(in, "gyro_slope");
      board.accel_zero = in.vector("accel_zero", kMostZero);
      board.accel_slope = slope(in, "accel_slope");
    });
  }
  return calibration;
}

void WearableCalibration::save(const std::filesystem::path& file, const Garment& of) const {
  std::string out = fmt::format(
      "# A garment's calibration. Made by 'secondskin calibrate wearable'.\n"
      "# offset: inflection less time of flight [A/D samples]; strength: peak power times squared\n"
      "# distance [A/D counts^2 m^2]; value = slope * (code - zero) [rad/s, m/s^2].\n"
      "garment = \"{}\"\ntemperature = {:.2f}\n",
      garment, temperature);
  for (std::size_t i = 0; i < sources.size(); ++i) {
    out += fmt::format("\n[[source]]\nname = \"{}\"\noffset = {:.4f}\nstrength = {:.6g}\n",
                       of.sources[i].name, sources[i].offset, sources[i].strength);
  }
  for (std::size_t i = 0; i < boards.size(); ++i) {
    out += fmt::format(
        "\n[[board]]\nname = \"{}\"\ngyro_zero = {}\ngyro_slope = {}\naccel_zero = {}\n"
        "accel_slope = {}\n",
        of.boards[i].name, written(boards[i].gyro_zero), written(boards[i].gyro_slope),
        written(boards[i].accel_zero), written(boards[i].accel_slope));
  }
  write_whole_file(file, out);
}

Eigen::Vector3d gyro_of(const wire::InertialCode& code, const BoardCalibration& board) noexcept {
  return board.gyro_slope.cwiseProduct(triple(code, 0) - board.gyro_zero);
}

Eigen::Vector3d accel_of(const wire::InertialCode& code, const BoardCalibration& board) noexcept {
  return board.accel_slope.cwiseProduct(triple(code, 3) - board.accel_zero);
}

bool saturated(const wire::InertialCode& code, std::size_t first) noexcept {
  for (std::size_t i = first; i < first + 3; ++i) {
    if (code.values[i] == 0 || code.values[i] == wire::kValueCodes - 1) return true;
  }
  return false;
}

}  // namespace secondskin::server
