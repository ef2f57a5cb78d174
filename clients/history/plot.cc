#include "clients/history/plot.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <numbers>
#include <vector>

namespace secondskin::history {
namespace {

// Okabe and Ito's blue and vermilion: apart for colour-blind eyes, and in grey.
constexpr const char* kCued = "#0072b2";
constexpr const char* kAlone = "#d55e00";
constexpr const char* kInk = "#222222";
constexpr const char* kGrid = "#dddddd";
constexpr double kWidth = 660.0;
constexpr std::int64_t kTwoDays = 2 * 86'400'000'000'000;
constexpr std::size_t kMostJoints = 12;

double deg(double radians) { return radians * 180.0 / std::numbers::pi; }

std::string date(std::int64_t ns) {
  return fmt::format("{:%d %b %Y}", fmt::gmtime(static_cast<std::time_t>(ns / 1'000'000'000)));
}

std::string line(double x1, double y1, double x2, double y2, const char* colour, double width) {
  return fmt::format(
      R"(<line x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}" stroke="{}" stroke-width="{}"/>)",
      x1, y1, x2, y2, colour, width);
}

std::string text(double x, double y, const char* anchor, const std::string& words) {
  return fmt::format(
      R"(<text x="{:.1f}" y="{:.1f}" text-anchor="{}" font-size="11" font-family="sans-serif" fill="{}">{}</text>)",
      x, y, anchor, kInk, escaped(words));
}

std::string mark(double x, double y, bool cued) {
  return cued ? fmt::format(R"(<circle cx="{:.1f}" cy="{:.1f}" r="4" fill="{}"/>)", x, y, kCued)
              : fmt::format(R"(<rect x="{:.1f}" y="{:.1f}" width="8" height="8" fill="#ffffff" )"
                            R"(stroke="{}" stroke-width="2"/>)",
                            x - 4.0, y - 4.0, kAlone);
}

std::string begin(double height, const std::string& title) {
  return fmt::format(R"(<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {} {}" width="100%" )"
                     R"(role="img" aria-label="{}">)",
                     kWidth, height, escaped(title));
}

}  // namespace

std::string escaped(const std::string& text) {
  std::string result;
  for (const char c : text) {
    switch (c) {
      case '&':
        result += "&amp;";
        break;
      case '<':
        result += "&lt;";
        break;
      case '>':
        result += "&gt;";
        break;
      case '"':
        result += "&quot;";
        break;
      case '\'':
        result += "&#39;";
        break;
      default:
        // Control characters are not allowed in a page.
        result += static_cast<unsigned char>(c) < 0x20 && c != '\n' ? ' ' : c;
    }
  }
  return result;
}

std::string spoken(const std::string& name) {
  std::string result = name;
  std::replace(result.begin(), result.end(), '_', ' ');
  return result;
}

std::string score_plot(std::span<const ProgressPoint> points) {
  if (points.empty()) return {};
  constexpr double kLeft = 36.0, kRight = 14.0, kTop = 24.0, kBottom = 190.0, kHeight = 220.0,
                   kApart = 9.0;
  const std::int64_t from = points.front().start_ns, to = points.back().start_ns;
  const bool by_time = to - from > kTwoDays;
  const double span = kWidth - kLeft - kRight - (by_time ? 56.0 : 20.0);
  const auto session_start = [&](std::size_t i) {
    while (i > 0 && points[i - 1].session == points[i].session) --i;
    return points[i].start_ns;
  };
  const auto x = [&](std::size_t i) {
    const double share =
        by_time ? static_cast<double>(session_start(i) - from) / static_cast<double>(to - from)
                : (points.size() > 1 ? static_cast<double>(i) / double(points.size() - 1) : 0.5);
    // Blocks of one session would lie upon one another.
    double within = 0.0;
    if (by_time) {
      for (std::size_t j = i; j > 0 && points[j - 1].session == points[i].session; --j) ++within;
    }
    return kLeft + 10.0 + share * span + kApart * within;
  };
  const auto y = [&](double total) { return kBottom - (kBottom - kTop) * total / 100.0; };

  std::string svg = begin(kHeight, "mean score of each block over time");
  for (int total = 0; total <= 100; total += 20) {
    svg += line(kLeft, y(total), kWidth - kRight, y(total), kGrid, 1);
    svg += text(kLeft - 6, y(total) + 4, "end", fmt::format("{}", total));
  }
  svg += mark(kLeft + 8, 10, true) + text(kLeft + 18, 14, "start", "with cues");
  svg += mark(kLeft + 98, 10, false) + text(kLeft + 108, 14, "start", "without cues");
  for (const bool cued : {true, false}) {
    std::string path;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if ((points[i].schedule != kNoCues) != cued) continue;
      path += fmt::format("{:.1f},{:.1f} ", x(i), y(points[i].mean_total));
    }
    svg += fmt::format(R"(<polyline points="{}" fill="none" stroke="{}" stroke-width="1.2"{}/>)",
                       path, cued ? kCued : kAlone, cued ? "" : R"( stroke-dasharray="4 3")");
  }
  double labelled = -1e9;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double sd = points[i].sd_total.value_or(0.0), total = points[i].mean_total;
    const bool cued = points[i].schedule != kNoCues;
    svg += line(x(i), y(std::max(0.0, total - sd)), x(i), y(std::min(100.0, total + sd)),
                cued ? kCued : kAlone, 1);
    svg += mark(x(i), y(total), cued);
    const bool last = i + 1 == points.size();
    if (x(i) - labelled < 74.0 || (!last && x(points.size() - 1) - x(i) < 74.0)) continue;
    if (i > 0 && !last && points[i].session == points[i - 1].session) continue;
    labelled = x(i);
    const bool edge = last && points.size() > 1;
    svg += text(edge ? x(i) + 8 : x(i), kHeight - 12, edge ? "end" : "middle",
                date(points[i].start_ns));
  }
  return svg + "</svg>";
}

std::string joint_plot(const ProgressPoint& first, const ProgressPoint& last) {
  struct Row {
    std::string joint;
    double before, after;
  };
  std::vector<Row> rows;
  for (const auto& [joint, rms] : first.joints) {
    const auto now = last.joints.find(joint);
    if (now != last.joints.end()) rows.push_back({joint, deg(rms), deg(now->second)});
  }
  if (rows.empty()) return {};
  const auto larger = [](const Row& row) { return std::max(row.before, row.after); };
  std::sort(rows.begin(), rows.end(),
            [&](const Row& a, const Row& b) { return larger(a) > larger(b); });
  rows.resize(std::min(rows.size(), kMostJoints));
  const double step = larger(rows.front()) > 40.0 ? 20.0 : larger(rows.front()) > 16.0 ? 10.0 : 4.0;
  const double most = step * std::ceil(larger(rows.front()) / step);
  constexpr double kLeft = 110.0, kRight = 20.0, kTop = 26.0, kRow = 18.0;
  const double bottom = kTop + kRow * static_cast<double>(rows.size());
  const auto x = [&](double angle) { return kLeft + (kWidth - kLeft - kRight) * angle / most; };

  std::string svg = begin(bottom + 26.0, "error of each joint, first and last block");
  for (double angle = 0.0; angle <= most + 1e-9; angle += step) {
    svg += line(x(angle), kTop, x(angle), bottom, kGrid, 1);
    svg += text(x(angle), bottom + 14, "middle", fmt::format("{:g}°", angle));
  }
  svg +=
      fmt::format(R"(<circle cx="{}" cy="12" r="4" fill="#ffffff" stroke="{}" stroke-width="2"/>)",
                  kLeft + 8, kInk) +
      text(kLeft + 18, 16, "start", date(first.start_ns));
  svg += fmt::format(R"(<circle cx="{}" cy="12" r="4" fill="{}"/>)", kLeft + 98, kInk) +
         text(kLeft + 108, 16, "start", date(last.start_ns));
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const double y = kTop + kRow * (static_cast<double>(i) + 0.5);
    const Row& row = rows[i];
    svg += text(kLeft - 8, y + 4, "end", spoken(row.joint));
    svg += line(x(row.before), y, x(row.after), y, "#888888", 2);
    svg += fmt::format(
        R"(<circle cx="{:.1f}" cy="{:.1f}" r="4" fill="#ffffff" stroke="{}" stroke-width="2"/>)",
        x(row.before), y, kInk);
    svg +=
        fmt::format(R"(<circle cx="{:.1f}" cy="{:.1f}" r="4" fill="{}"/>)", x(row.after), y, kInk);
  }
  return svg + "</svg>";
}

}  // namespace secondskin::history
