#include "motion/trc.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <istream>
#include <iterator>
#include <limits>
#include <ostream>
#include <sstream>
#include <unordered_set>

#include "motion/whole_file.h"

namespace secondskin {
namespace {

// Larger numbers are no lengths in any unit.
constexpr double kLargestValue = 1e9;
constexpr double kMillimetre = 0.001;

std::string_view trimmed(std::string_view field) noexcept {
  const auto blank = [](char c) { return c == ' ' || c == '\r'; };
  while (!field.empty() && blank(field.front())) field.remove_prefix(1);
  while (!field.empty() && blank(field.back())) field.remove_suffix(1);
  return field;
}

class Parser {
 public:
  Parser(std::string_view text, std::string_view name) : text_(text), name_(name) {
    if (text_.starts_with("\xEF\xBB\xBF")) at_ = 3;
  }

  MarkerMotion parse() {
    read_header();
    read_names();
    while (next_line()) {
      if (std::all_of(fields_.begin(), fields_.end(), [](auto f) { return f.empty(); })) continue;
      read_row();
    }
    const std::size_t rows = motion_.frames.size();
    if (rows != frames_) {
      fail(fmt::format("{} rows of data", rows), fmt::format("NumFrames, {}", frames_));
    }
    // A time may be printed with as few as two decimals.
    const double span = static_cast<double>(rows - 1) / motion_.rate_hz;
    const double told = last_time_ - first_time_;
    if (!(std::abs(told - span) <= 0.02 * span + 0.01)) {
      fail(fmt::format("{} rows over {:.4f} s", rows, told),
           fmt::format("{:.4f} s at DataRate, {} Hz", span, motion_.rate_hz));
    }
    return std::move(motion_);
  }

 private:
  [[noreturn]] void fail(std::string_view found, std::string_view expected) const {
    throw TrcError(fmt::format("{}:{}: found {}, expected {}", name_, line_, found, expected));
  }
  static std::string quoted(std::string_view token) {
    std::string shown(token.substr(0, 40));
    std::replace_if(
        shown.begin(), shown.end(), [](char c) { return static_cast<unsigned char>(c) < 32; }, '?');
    return fmt::format("\"{}\"", shown);
  }

  // Cuts the next line at its tabs; false at the end of the file.
  bool next_line() {
    fields_.clear();
    if (at_ >= text_.size()) return false;
    ++line_;
    const std::size_t end = std::min(text_.find('\n', at_), text_.size());
    std::string_view line = text_.substr(at_, end - at_);
    at_ = end + 1;
    for (;;) {
      const std::size_t tab = line.find('\t');
      fields_.push_back(trimmed(line.substr(0, tab)));
      if (tab == std::string_view::npos) return true;
      line.remove_prefix(tab + 1);
    }
  }
  void need_line(std::string_view expected) {
    if (!next_line()) {
      ++line_;
      fail("the end of the file", expected);
    }
  }

  double number(std::string_view token, std::string_view expected) const {
    const char* begin = token.data();
    const char* end = begin + token.size();
    if (begin != end && *begin == '+') ++begin;
    double value = 0.0;
    const auto [stop, error] = std::from_chars(begin, end, value);
    if (begin == end || stop != end || error != std::errc() || std::abs(value) > kLargestValue) {
      fail(quoted(token), expected);
    }
    return value;
  }

  void read_header() {
    constexpr std::string_view kFirst = "PathFileType, which begins a TRC file";
    need_line(kFirst);
    if (fields_[0] != "PathFileType") fail(quoted(fields_[0]), kFirst);
    need_line("the names DataRate, NumFrames, NumMarkers, Units");
    const std::vector<std::string_view> names = fields_;
    need_line("the values of DataRate, NumFrames, NumMarkers, Units");
    const auto value = [&](std::string_view name) {
      const auto place = std::find(names.begin(), names.end(), name);
      const auto i = static_cast<std::size_t>(place - names.begin());
      if (place == names.end() || i >= fields_.size() || fields_[i].empty()) {
        fail("nothing", fmt::format("a value of {}", name));
      }
      return fields_[i];
    };
    const auto count = [&](std::string_view name) {
      const std::string expected = fmt::format("{} from 1 to 10000000", name);
      const double whole = number(value(name), expected);
      if (!(whole >= 1.0 && whole <= 1e7) || whole != std::floor(whole)) {
        fail(quoted(value(name)), expected);
      }
      return static_cast<std::size_t>(whole);
    };
    const std::string_view rate = value("DataRate");
    constexpr std::string_view kRate = "DataRate from 0.001 to 1000000";
    motion_.rate_hz = number(rate, kRate);
    if (!(motion_.rate_hz >= 1e-3 && motion_.rate_hz <= 1e6)) fail(quoted(rate), kRate);
    frames_ = count("NumFrames");
    markers_ = count("NumMarkers");
    const std::string_view unit = value("Units");
    if (unit == "mm") {
      metres_ = kMillimetre;
    } else if (unit == "cm") {
      metres_ = 0.01;
    } else if (unit == "m") {
      metres_ = 1.0;
    } else if (unit == "in") {
      metres_ = 0.0254;
    } else {
      fail(quoted(unit), "Units mm, cm, m or in");
    }
  }

  // "Frame#  Time  name  (blank)  (blank)  name …"; then "X1 Y1 Z1 …" below.
  void read_names() {
    constexpr std::string_view kNames = "Frame#, Time and the markers' names";
    need_line(kNames);
    if (fields_[0] != "Frame#" || fields_.size() < 2 || fields_[1] != "Time") {
      fail(quoted(fields_[0]), kNames);
    }
    std::unordered_set<std::string_view> seen;
    for (std::size_t i = 2; i < fields_.size(); ++i) {
      if (fields_[i].empty()) continue;
      if ((i - 2) % 3 != 0) {
        fail(fmt::format("{} in column {}", quoted(fields_[i]), i + 1),
             "a marker's name over the first of its three columns");
      }
      if (!seen.insert(fields_[i]).second) fail(quoted(fields_[i]), "each name once");
      if (motion_.names.size() != (i - 2) / 3) {
        fail(fmt::format("no name before {}", quoted(fields_[i])), "a name for each marker");
      }
      motion_.names.emplace_back(fields_[i]);
    }
    if (motion_.names.size() != markers_) {
      fail(fmt::format("{} names", motion_.names.size()), fmt::format("NumMarkers, {}", markers_));
    }
    need_line("X1, Y1, Z1, …");
    if (fields_.size() < 3 || (fields_[2] != "X1" && fields_[2] != "x1")) {
      fail(quoted(fields_.size() < 3 ? "" : fields_[2]), "X1, Y1, Z1, … below the names");
    }
  }

  void read_row() {
    const std::size_t columns = 2 + 3 * markers_;
    for (std::size_t i = columns; i < fields_.size(); ++i) {
      if (!fields_[i].empty()) {
        fail(fmt::format("{} in column {}", quoted(fields_[i]), i + 1),
             fmt::format("{} columns", columns));
      }
    }
    if (motion_.frames.size() == frames_) {
      fail("a further row of data", fmt::format("NumFrames, {}", frames_));
    }
    fields_.resize(columns);
    number(fields_[0], "a frame's number");
    last_time_ = number(fields_[1], "a time in seconds");
    if (!std::isfinite(last_time_)) fail(quoted(fields_[1]), "a time in seconds");
    if (motion_.frames.empty()) first_time_ = last_time_;
    MarkerFrame& frame = motion_.frames.emplace_back(markers_);
    for (std::size_t i = 0; i < markers_; ++i) {
      const auto* field = &fields_[2 + 3 * i];
      const auto blank = std::count_if(field, field + 3, [](auto f) { return f.empty(); });
      if (blank == 3) continue;
      if (blank > 0) {
        fail(fmt::format("{} blank of the three fields of {}", blank, motion_.names[i]),
             "none or all");
      }
      Eigen::Vector3d p;
      for (int k = 0; k < 3; ++k) {
        p[k] = number(field[k], fmt::format("a number or nothing in column {}", 3 + 3 * i + k));
      }
      if (!p.allFinite() || p.isZero(0.0)) continue;
      frame.p_WM[i] = metres_ * p;
      frame.visible[i] = 1;
    }
  }

  std::string_view text_;
  std::string_view name_;
  std::size_t at_ = 0;
  std::size_t line_ = 0;
  std::vector<std::string_view> fields_;
  MarkerMotion motion_;
  std::size_t frames_ = 0;
  std::size_t markers_ = 0;
  double metres_ = kMillimetre;
  double first_time_ = 0.0;
  double last_time_ = 0.0;
};

}  // namespace

MarkerMotion read_trc(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::error_code ignored;
  if (!in || std::filesystem::is_directory(file, ignored)) {
    throw TrcError(fmt::format("{}:1: found no readable file, expected a TRC file", file.string()));
  }
  return read_trc(in, file.string());
}

MarkerMotion read_trc(std::istream& in, std::string_view name) {
  std::string text;
  std::array<char, 1 << 16> block;
  while (in.read(block.data(), block.size()) || in.gcount() > 0) {
    text.append(block.data(), static_cast<std::size_t>(in.gcount()));
  }
  return Parser(text, name).parse();
}

void write_trc(const MarkerMotion& markers, std::ostream& out, std::string_view name) {
  for (const std::string& marker : markers.names) {
    if (marker.empty() || trimmed(marker) != marker ||
        marker.find_first_of("\t\r\n") != std::string::npos) {
      throw TrcError(
          fmt::format("{}:4: found marker name \"{}\", expected one without tabs, line "
                      "ends or blanks around it",
                      name, marker));
    }
  }
  fmt::memory_buffer text;
  auto at = std::back_inserter(text);
  fmt::format_to(at, "PathFileType\t4\t(X/Y/Z)\t{}\n", name);
  fmt::format_to(at,
                 "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\t"
                 "OrigDataStartFrame\tOrigNumFrames\n");
  fmt::format_to(at, "{0}\t{0}\t{1}\t{2}\tmm\t{0}\t1\t{1}\n", markers.rate_hz,
                 markers.frames.size(), markers.names.size());
  fmt::format_to(at, "Frame#\tTime");
  for (const std::string& marker : markers.names) fmt::format_to(at, "\t{}\t\t", marker);
  fmt::format_to(at, "\n\t");
  for (std::size_t i = 1; i <= markers.names.size(); ++i) {
    fmt::format_to(at, "\tX{0}\tY{0}\tZ{0}", i);
  }
  fmt::format_to(at, "\n\n");
  for (std::size_t f = 0; f < markers.frames.size(); ++f) {
    const MarkerFrame& frame = markers.frames[f];
    fmt::format_to(at, "{}\t{:.6f}", f + 1, static_cast<double>(f) / markers.rate_hz);
    for (std::size_t i = 0; i < markers.names.size(); ++i) {
      if (frame.visible[i] != 0) {
        const Eigen::Vector3d p = frame.p_WM[i] / kMillimetre;
        fmt::format_to(at, "\t{:.5f}\t{:.5f}\t{:.5f}", p.x(), p.y(), p.z());
      } else {
        fmt::format_to(at, "\t\t\t");
      }
    }
    text.push_back('\n');
  }
  out.write(text.data(), static_cast<std::streamsize>(text.size()));
}

void write_trc(const MarkerMotion& markers, const std::filesystem::path& file) {
  std::ostringstream text;
  write_trc(markers, text, file.filename().string());
  write_whole_file(file, std::move(text).str());
}

}  // namespace secondskin
