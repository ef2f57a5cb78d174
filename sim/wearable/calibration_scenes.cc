#include "sim/wearable/calibration_scenes.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

namespace secondskin::sim {
namespace {

const Eigen::Vector3d kUp = Eigen::Vector3d::UnitZ();

// From 0 to 1 without a jerk at the ends; its slope and its integral from 0.
double smooth(double t) noexcept { return t * t * (3.0 - 2.0 * t); }
double smooth_slope(double t) noexcept { return 6.0 * t * (1.0 - t); }
double smooth_integral(double t) noexcept { return t * t * t * (1.0 - 0.5 * t); }

double length_of(const BenchStop& stop) noexcept {
  return BenchScene::kMove + stop.seconds + (stop.rate != 0.0 ? 2.0 * BenchScene::kMove : 0.0);
}

// The table's turn since a stop's orientation was reached.
struct Turn {
  double angle = 0.0, rate = 0.0, acceleration = 0.0;
};

Turn turn_of(const BenchStop& stop, double t) noexcept {
  constexpr double T = BenchScene::kMove;
  Turn turn;
  if (stop.rate == 0.0) return turn;
  const double up = std::clamp(t / T, 0.0, 1.0);
  const double at_full = std::clamp(t - T, 0.0, stop.seconds);
  const double down = std::clamp((t - T - stop.seconds) / T, 0.0, 1.0);
  turn.angle = stop.rate * (T * smooth_integral(up) + at_full + T * (down - smooth_integral(down)));
  turn.rate = stop.rate * (smooth(up) - smooth(down));
  turn.acceleration = stop.rate / T * (smooth_slope(up) - smooth_slope(down));
  return turn;
}

}  // namespace

StandScene::StandScene(Garment garment, const WornErrors& errors, std::uint64_t placement,
                       double seconds)
    : garment_(std::move(garment)), errors_(errors), seconds_(seconds) {
  std::mt19937_64 random(0x57A7D + placement);
  std::uniform_real_distribution<double> aside(-0.15, 0.15), away(kNearest, kFarthest);
  const auto stand = [](const Eigen::Vector3d& p, const Eigen::Vector3d& z) {
    Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
    X.translation() = p;
    X.linear() = Eigen::Quaterniond::FromTwoVectors(kUp, z).toRotationMatrix();
    return X;
  };
  for (std::size_t i = 0; i < garment_.sources.size(); ++i) {
    const double y =
        0.04 * (static_cast<double>(i) - 0.5 * static_cast<double>(garment_.sources.size()));
    still_.sources.push_back(stand({0.0, y, kHeight}, Eigen::Vector3d::UnitX()));
    still_.source_v.push_back(Eigen::Vector3d::Zero());
  }
  for (std::size_t i = 0; i < garment_.boards.size(); ++i) {
    BoardTruth board;
    const Eigen::Vector3d p{away(random), aside(random), kHeight + 0.5 * aside(random)};
    board.X_WS = stand(p, -Eigen::Vector3d::UnitX());
    board.accel = board.X_WS.linear().transpose() * (kStandardGravity * kUp);
    still_.boards.push_back(board);
  }
  table_.push_back({kUp, 0.0, 0.7});
}

void StandScene::boards_at(double /*time*/, std::span<BoardTruth> boards) const noexcept {
  std::copy_n(still_.boards.begin(), std::min(boards.size(), still_.boards.size()), boards.begin());
}

void StandScene::at(double /*time*/, GarmentInstant& out) const { out = still_; }

double StandScene::distance(std::size_t source, std::size_t board) const noexcept {
  return (still_.sources[source].translation() - still_.boards[board].X_WS.translation()).norm();
}

BenchScene::BenchScene(Garment garment, const WornErrors& errors, std::vector<BenchStop> stops,
                       double slip, std::uint64_t seed)
    : garment_(std::move(garment)), errors_(errors), stops_(std::move(stops)) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  for (std::size_t i = 0; i < garment_.boards.size() * stops_.size(); ++i) {
    const double x = normal(random), y = normal(random), z = normal(random);
    const Eigen::Vector3d turn = slip / std::numbers::sqrt3 * Eigen::Vector3d(x, y, z);
    const double angle = turn.norm();
    slip_.emplace_back(Eigen::AngleAxisd(angle, angle > 0.0 ? turn.normalized() : kUp));
  }
}

double BenchScene::duration() const noexcept {
  double sum = 0.0;
  for (const auto& stop : stops_) sum += length_of(stop);
  return sum;
}

void BenchScene::boards_at(double time, std::span<BoardTruth> boards) const noexcept {
  if (stops_.empty()) return;
  std::size_t s = 0;
  while (s + 1 < stops_.size() && time >= length_of(stops_[s])) time -= length_of(stops_[s++]);
  const BenchStop& stop = stops_[s];
  const Turn turn = turn_of(stop, time - kMove);
  const double moved = std::clamp(time / kMove, 0.0, 1.0);
  for (std::size_t b = 0; b < boards.size(); ++b) {
    // By hand from where the stop before has left it, on the way that turns least.
    const Eigen::Quaterniond to = stop.q_WS * slip_[b * stops_.size() + s];
    Eigen::Quaterniond from = to;
    if (s > 0) {
      const double left = turn_of(stops_[s - 1], length_of(stops_[s - 1])).angle;
      from = Eigen::AngleAxisd(left, kUp) * stops_[s - 1].q_WS * slip_[b * stops_.size() + s - 1];
    }
    const Eigen::AngleAxisd way(from.conjugate() * to);
    const Eigen::Quaterniond by_hand =
        from * Eigen::Quaterniond(Eigen::AngleAxisd(smooth(moved) * way.angle(), way.axis()));
    const Eigen::Quaterniond table(Eigen::AngleAxisd(turn.angle, kUp));
    const Eigen::Quaterniond q_WS = table * by_hand;
    const double place =
        2.0 * std::numbers::pi * static_cast<double>(b) / static_cast<double>(boards.size());
    const Eigen::Vector3d p =
        table * Eigen::Vector3d(kRadius * std::cos(place), kRadius * std::sin(place), 0.0);
    BoardTruth& out = boards[b];
    out.X_WS.linear() = q_WS.toRotationMatrix();
    out.X_WS.translation() = p + Eigen::Vector3d(0.0, 0.0, 1.0);
    const Eigen::Vector3d w_W = turn.rate * kUp;
    out.v = w_W.cross(p);
    out.a = turn.acceleration * kUp.cross(p) + w_W.cross(out.v);
    const double hand_rate = moved < 1.0 ? smooth_slope(moved) * way.angle() / kMove : 0.0;
    out.gyro = q_WS.conjugate() * w_W + hand_rate * way.axis();
    out.accel = q_WS.conjugate() * (out.a + kStandardGravity * kUp);
  }
}

void BenchScene::at(double time, GarmentInstant& out) const {
  out.boards.resize(garment_.boards.size());
  boards_at(time, out.boards);
  // The sources lie beside it, out of the way.
  out.sources.resize(garment_.sources.size());
  out.source_v.assign(garment_.sources.size(), Eigen::Vector3d::Zero());
  for (auto& X : out.sources) {
    X = Eigen::Isometry3d::Identity();
    X.translation() = Eigen::Vector3d(1.0, 0.0, 1.0);
  }
}

std::vector<BenchStop> six_sides(double seconds) { return six_turns(0.0, seconds); }

std::vector<BenchStop> six_turns(double rate, double seconds) {
  std::vector<BenchStop> stops;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double sign : {1.0, -1.0}) {
      const Eigen::Vector3d up = sign * Eigen::Vector3d::Unit(axis);
      stops.push_back({Eigen::Quaterniond::FromTwoVectors(up, kUp), seconds, rate});
    }
  }
  return stops;
}

std::vector<BenchStop> still_poses(std::size_t count, std::uint64_t seed, double seconds) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> turn(0.0, 2.0 * std::numbers::pi);
  std::vector<BenchStop> stops;
  // Directions of gravity spread evenly over the sphere (a Fibonacci lattice), turned at random.
  const double golden = std::numbers::pi * (3.0 - std::sqrt(5.0));
  const Eigen::Quaterniond whole(
      Eigen::AngleAxisd(turn(random), Eigen::Vector3d(1, 2, 3) / std::sqrt(14.0)));
  for (std::size_t i = 0; i < count; ++i) {
    const double z = 1.0 - 2.0 * (static_cast<double>(i) + 0.5) / static_cast<double>(count);
    const double r = std::sqrt(1.0 - z * z), a = golden * static_cast<double>(i);
    const Eigen::Vector3d up = whole * Eigen::Vector3d(r * std::cos(a), r * std::sin(a), z);
    stops.push_back(
        {Eigen::AngleAxisd(turn(random), kUp) * Eigen::Quaterniond::FromTwoVectors(up, kUp),
         seconds, 0.0});
  }
  return stops;
}

}  // namespace secondskin::sim
