#include "server/optical/calibrate/grid_calibration.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "server/optical/calibrate/projector_fit.h"

namespace secondskin::server {
namespace {

constexpr int kNear = 3;  // readings so near the most usual one are no wild ones [counts]
constexpr double kLeastShare = 0.3;    // of the readings must be near it
constexpr double kGoodResidual = 1.5;  // RMS of a projector that fits [counts]
constexpr double kWorstCost = 6.0;     // a reading's share of the cost of a hypothesis [counts]

// What one detector read at one height, by projector.
struct Place {
  std::size_t detector;
  std::size_t height;
  double value;
};

using Order = std::vector<std::size_t>;  // which of the grid's places a detector stands at

std::vector<Reading> readings(const CalibrationGrid& grid, const std::vector<Place>& places,
                              const Order& order) {
  std::vector<Reading> out;
  for (const Place& p : places) {
    out.push_back(
        {grid.p_W[order[p.detector]] + Eigen::Vector3d(0.0, 0.0, grid.heights[p.height]), p.value});
  }
  return out;
}

// Sum of |residual| over all readings, each at most kWorstCost.
double cost(const CalibrationGrid& grid, const std::vector<std::vector<Place>>& places,
            const Order& order) {
  double sum = 0.0;
  for (const auto& of_projector : places) {
    const auto all = readings(grid, of_projector, order);
    const auto fit = fit_projector(all, 0);
    if (!fit) continue;
    for (const Reading& r : all) {
      sum += std::min(std::fabs(fit->projector.value(r.p_W) - r.value), kWorstCost);
    }
  }
  return sum;
}

// The exchanges that make the values fit, best first; empty where none helps clearly.
std::vector<std::pair<std::size_t, std::size_t>> exchanges(
    const CalibrationGrid& grid, const std::vector<std::vector<Place>>& places) {
  std::vector<std::pair<std::size_t, std::size_t>> found;
  Order order(grid.p_W.size());
  std::iota(order.begin(), order.end(), 0U);
  double now = cost(grid, places, order);
  while (found.size() < order.size() / 2) {
    double best = now;
    std::pair<std::size_t, std::size_t> pair;
    for (std::size_t a = 0; a < order.size(); ++a) {
      for (std::size_t b = a + 1; b < order.size(); ++b) {
        std::swap(order[a], order[b]);
        if (const double c = cost(grid, places, order); c < best) {
          best = c;
          pair = {a, b};
        }
        std::swap(order[a], order[b]);
      }
    }
    if (best > 0.9 * now) break;
    std::swap(order[pair.first], order[pair.second]);
    found.push_back(pair);
    now = best;
  }
  std::size_t count = 0;
  for (const auto& p : places) count += p.size();
  // Not "less bad" but good: what remains is noise.
  if (now > kGoodResidual * static_cast<double>(count)) found.clear();
  return found;
}

}  // namespace

GridCalibration::GridCalibration(CalibrationGrid grid, std::size_t projectors)
    : grid_(std::move(grid)), projectors_(projectors) {
  if (grid_.p_W.empty() || grid_.heights.empty()) {
    throw std::invalid_argument("a calibration grid needs detectors and at least one height");
  }
  histograms_.resize(grid_.heights.size() * grid_.p_W.size() * projectors_);
}

void GridCalibration::add(const ProjectorFrame& frame, std::size_t height) {
  if (frame.detectors != grid_.p_W.size() || frame.projectors != projectors_) {
    throw std::invalid_argument(
        fmt::format("frame {} has {} detectors and {} projectors; expected {} and {}", frame.cycle,
                    frame.detectors, frame.projectors, grid_.p_W.size(), projectors_));
  }
  if (height >= grid_.heights.size()) {
    throw std::invalid_argument(
        fmt::format("no height {}; the grid has {}", height, grid_.heights.size()));
  }
  const std::size_t first = height * frame.values.size();
  for (std::size_t k = 0; k < frame.values.size(); ++k) {
    const std::uint8_t v = frame.values[k];
    // The first and the last value also stand for what lies beyond them.
    if (v > 1 && v < 254) ++histograms_[first + k].counts[v];
  }
}

std::optional<double> GridCalibration::value(std::size_t detector, std::size_t projector,
                                             std::size_t height) const {
  const auto& counts = histogram(detector, projector, height).counts;
  const auto near = [&](int v, auto weight) {
    double sum = 0.0;
    for (int u = std::max(0, v - kNear); u <= std::min(255, v + kNear); ++u) {
      sum += weight(u) * counts[static_cast<std::size_t>(u)];
    }
    return sum;
  };
  const auto one = [](int) { return 1.0; };
  int usual = 0;
  for (int v = 1; v < 255; ++v) {
    if (near(v, one) > near(usual, one)) usual = v;
  }
  // The window about the mean of the first: the most usual window may lie one beside.
  const double mean = near(usual, [](int v) { return v; }) / std::max(1.0, near(usual, one));
  usual = static_cast<int>(std::lround(mean));
  const double count = near(usual, one);
  const double all = std::accumulate(counts.begin(), counts.end(), 0.0);
  if (count < kLeastReadings || count < kLeastShare * all) return std::nullopt;
  return near(usual, [](int v) { return v; }) / count;
}

tl::expected<GridResult, Refusal> GridCalibration::solve() const {
  std::vector<std::vector<Place>> places(projectors_);
  for (std::size_t i = 0; i < projectors_; ++i) {
    for (std::size_t h = 0; h < grid_.heights.size(); ++h) {
      for (std::size_t d = 0; d < grid_.p_W.size(); ++d) {
        if (const auto v = value(d, i, h)) places[i].push_back({d, h, *v});
      }
    }
  }
  Order order(grid_.p_W.size());
  std::iota(order.begin(), order.end(), 0U);

  GridResult result;
  result.rig.projectors.resize(projectors_);
  result.projectors.resize(projectors_);
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const auto& p : grid_.p_W) middle += p / static_cast<double>(grid_.p_W.size());
  middle.z() += 0.5 * (*std::min_element(grid_.heights.begin(), grid_.heights.end()) +
                       *std::max_element(grid_.heights.begin(), grid_.heights.end()));
  std::size_t fitted = 0, misfits = 0;
  std::optional<Refusal> first;
  for (std::size_t i = 0; i < projectors_; ++i) {
    GridProjector& report = result.projectors[i];
    report.points = places[i].size();
    const auto fit = fit_projector(readings(grid_, places[i], order));
    if (!fit) {
      report.refused = fit.error();
      if (!first) first = fit.error();
      continue;
    }
    report.fitting = fit->fitting;
    report.residual = fit->residual;
    report.residual_mm = 1e3 * fit->residual / fit->projector.gradient(middle).norm();
    if (10 * fit->fitting < 9 * report.points || fit->residual > kGoodResidual) {
      ++misfits;
      report.refused =
          Refusal{RefusalKind::kDoesNotFit,
                  fmt::format("only {} of {} readings fit a projector (RMS {:.2f} counts); did it "
                              "or the grid move?",
                              fit->fitting, report.points, fit->residual)};
      continue;
    }
    ++fitted;
    result.rig.projectors[i] = fit->projector;
  }
  if (misfits > 0) {
    std::vector<std::string> pairs;
    for (const auto& [a, b] : exchanges(grid_, places)) {
      pairs.push_back(fmt::format("{} and {}", std::min(a, b), std::max(a, b)));
    }
    if (!pairs.empty()) {
      return tl::unexpected(Refusal{
          RefusalKind::kExchanged,
          fmt::format("detectors {} seem to be exchanged: in each other's place all values fit",
                      fmt::join(pairs, ", "))});
    }
  }
  if (fitted == 0) {
    if (misfits > 0) {
      return tl::unexpected(
          Refusal{RefusalKind::kDoesNotFit,
                  "no projector fits its readings; are the grid's places and unit right?"});
    }
    return tl::unexpected(*first);
  }
  return result;
}

}  // namespace secondskin::server
