#include "motion/marker_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <string>

#include "motion/c3d.h"
#include "motion/trc.h"
#include "motion/ui_prmd.h"

namespace secondskin {
namespace {

enum class Format { kC3d, kTrc, kUiPrmd };

std::optional<Format> format_of(const std::filesystem::path& file) {
  std::string name = file.filename().string();
  std::transform(name.begin(), name.end(), name.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
  if (name.ends_with(".c3d")) return Format::kC3d;
  if (name.ends_with(".trc")) return Format::kTrc;
  if (name.ends_with(".txt") || name.ends_with(".txt.gz")) return Format::kUiPrmd;
  return std::nullopt;
}

// POINT:Y_SCREEN names the axis that points up on a screen.
UpAxis up_of(const C3dFile& content, const std::filesystem::path& file) {
  const C3dParameter* screen = content.find("POINT", "Y_SCREEN");
  if (screen == nullptr || screen->strings().empty() || screen->strings().front().empty()) {
    return UpAxis::kZ;
  }
  const std::string axis = screen->strings().front();
  if (axis == "+Z" || axis == "Z" || axis == "+z") return UpAxis::kZ;
  if (axis == "+Y" || axis == "Y" || axis == "+y") return UpAxis::kY;
  throw MarkerFileError(
      fmt::format("{}: POINT:Y_SCREEN: found \"{}\", expected +Y or +Z; say which axis is up "
                  "(--up y|z)",
                  file.string(), axis));
}

// y up: x_W = z_F, y_W = x_F, z_W = y_F, as retarget.cc has it.
void turn_y_up_to_z_up(MarkerMotion& motion) {
  for (MarkerFrame& frame : motion.frames) {
    for (Eigen::Vector3d& p : frame.p_WM) p = Eigen::Vector3d(p.z(), p.x(), p.y());
  }
}
void turn_z_up_to_y_up(MarkerMotion& motion) {
  for (MarkerFrame& frame : motion.frames) {
    for (Eigen::Vector3d& p : frame.p_WM) p = Eigen::Vector3d(p.y(), p.z(), p.x());
  }
}

}  // namespace

bool is_marker_file(const std::filesystem::path& file) { return format_of(file).has_value(); }

MarkerMotion read_markers(const std::filesystem::path& file, std::optional<UpAxis> up) {
  const std::optional<Format> format = format_of(file);
  if (!format) {
    throw MarkerFileError(
        fmt::format("{}: expected a marker file: .c3d, .trc, .txt or .txt.gz", file.string()));
  }
  MarkerMotion motion;
  UpAxis axis = UpAxis::kZ;
  switch (*format) {
    case Format::kC3d: {
      C3dFile content = read_c3d(file);
      axis = up ? *up : up_of(content, file);
      motion = std::move(content.markers);
      break;
    }
    case Format::kTrc:
      motion = read_trc(file);
      axis = up.value_or(UpAxis::kY);
      break;
    case Format::kUiPrmd:
      motion = read_ui_prmd_markers(file);
      axis = up.value_or(UpAxis::kZ);
      break;
  }
  if (axis == UpAxis::kY) turn_y_up_to_z_up(motion);
  return motion;
}

void write_markers(const MarkerMotion& markers, const std::filesystem::path& file) {
  const std::optional<Format> format = format_of(file);
  if (format == Format::kTrc) {
    MarkerMotion turned = markers;
    turn_z_up_to_y_up(turned);
    write_trc(turned, file);
  } else if (format == Format::kC3d) {
    C3dFile content;
    content.markers = markers;
    content.set("POINT", {.name = "UNITS", .dimensions = {2}, .values = std::string("mm")});
    content.set("POINT", {.name = "X_SCREEN", .dimensions = {2}, .values = std::string("+X")});
    content.set("POINT", {.name = "Y_SCREEN", .dimensions = {2}, .values = std::string("+Z")});
    write_c3d(content, file, C3dProcessor::kIntel, C3dStorage::kReal);
  } else {
    throw MarkerFileError(
        fmt::format("{}: expected a name that ends in .c3d or .trc", file.string()));
  }
}

}  // namespace secondskin
