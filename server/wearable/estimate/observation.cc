#include "server/wearable/estimate/observation.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <stdexcept>

#include "motion/rotation.h"

namespace secondskin::server {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// The derivatives of up to three observed numbers, gathered by the columns of the state.
class Gatherer {
 public:
  Gatherer(const BodyModel& body, const BodyState& state, int rows) noexcept
      : layout_(body.layout), state_(state), rows_(rows) {
    used_.fill(false);
  }

  // Adds M * block of a joint at a time after the state's, carried back to the state's time.
  void add(const JointMotion& joint, const Matrix3d& M, const JointBlock& block,
           double time) noexcept {
    if (joint.group == BodyLayout::kNoGroup) return;
    const auto g = static_cast<std::size_t>(joint.group);
    if (!used_[g]) {
      used_[g] = true;
      order_[count_++] = g;
      h_[g].setZero();
    }
    Eigen::Matrix<double, 3, 9>& h = h_[g];
    const Matrix3d rotation = M * block.rotation;
    const Matrix3d rate = M * block.rate;
    const Matrix3d acceleration = M * block.acceleration;
    if (time == 0.0) {
      h.leftCols<3>() += rotation;
      h.middleCols<3>(3) += rate;
      h.rightCols<3>() += acceleration;
      return;
    }
    const GroupTransition f = transition(state_.groups[g], time);
    const Matrix3d turned = rotation * f.jacobian;
    h.leftCols<3>() += rotation * f.turn;
    h.middleCols<3>(3) += time * turned + rate;
    h.rightCols<3>() += 0.5 * time * time * turned + time * rate + acceleration;
  }

  // The root's position, velocity or acceleration (level 0, 1, 2) at a time after the state's.
  void add_root(const Matrix3d& M, int level, double time) noexcept {
    double factor = 1.0;
    for (int i = level; i < 3; ++i) {
      root_.middleCols<3>(3 * i) += factor * M;
      factor *= time / (i - level + 1);
    }
    has_root_ = true;
  }

  void emit(const Vector3d& innovation, double variance, std::size_t tag, ObservationSet& set,
            int extra_entries_begin) const noexcept {
    SparseRows rows{set.size(), rows_, extra_entries_begin, 0};
    for (std::size_t i = 0; i < count_; ++i) {
      const auto g = static_cast<int>(order_[i]);
      for (int level = 0; level < 3; ++level) {
        put(layout_.rotation(g, level), h_[order_[i]], 3 * level, set);
      }
    }
    if (has_root_) {
      for (int level = 0; level < 3; ++level) put(layout_.root(level), root_, 3 * level, set);
    }
    rows.end = static_cast<int>(set.entries.size());
    for (int r = 0; r < rows_; ++r) {
      set.y.push_back(innovation[r]);
      set.variance.push_back(variance);
    }
    set.rows.push_back(rows);
    set.tag.push_back(tag);
  }

 private:
  void put(int column, const Eigen::Matrix<double, 3, 9>& h, int from,
           ObservationSet& set) const noexcept {
    if (h.middleCols<3>(from).topRows(rows_).isZero(0.0)) return;
    for (int c = 0; c < 3; ++c) {
      set.entries.push_back({column + c, {h(0, from + c), h(1, from + c), h(2, from + c)}});
    }
  }

  const BodyLayout& layout_;
  const BodyState& state_;
  int rows_;
  bool has_root_ = false;
  std::size_t count_ = 0;
  std::array<bool, kJointCount> used_;
  std::array<std::size_t, kJointCount> order_;
  std::array<Eigen::Matrix<double, 3, 9>, kJointCount> h_;
  Eigen::Matrix<double, 3, 9> root_ = Eigen::Matrix<double, 3, 9>::Zero();
};

void put_block(int column, const Matrix3d& h, ObservationSet& set) noexcept {
  for (int c = 0; c < 3; ++c) set.entries.push_back({column + c, {h(0, c), h(1, c), h(2, c)}});
}

// Three rows whose entries, from `begin` on, are in the set already.
void put_rows(int begin, const Vector3d& innovation, double variance, std::size_t tag,
              ObservationSet& set) noexcept {
  set.rows.push_back({set.size(), 3, begin, static_cast<int>(set.entries.size())});
  for (int r = 0; r < 3; ++r) {
    set.y.push_back(innovation[r]);
    set.variance.push_back(variance);
  }
  set.tag.push_back(tag);
}

// M with a row in its first row only.
Matrix3d as_row(const Vector3d& row) noexcept {
  Matrix3d m = Matrix3d::Zero();
  m.row(0) = row.transpose();
  return m;
}

// A microphone's distance from where sound was sent; that of a worn source with its own path.
// @returns false when they are at one place
bool put_distance(const BodyModel& body, const BodyState& state, std::size_t board,
                  const PathMotion& to_board, const PointMotion& microphone,
                  const PointMotion& emitter, const PathMotion* to_source, double z,
                  double variance, ObservationSet& set) noexcept {
  const Vector3d between = microphone.p - emitter.p;
  const double distance = between.norm();
  if (distance < 1e-3) return false;
  const Matrix3d M = as_row(between / (distance * state.sound));
  Gatherer gather(body, state, 1);
  const auto add = [&](const PathMotion& path, const PointMotion& at, const Matrix3d& by) {
    for (std::size_t i = 0; i < path.size; ++i) {
      gather.add(path.joints[i], by, position_block(path.joints[i], at), path.time);
    }
    gather.add_root(by, 0, path.time);
  };
  add(to_board, microphone, M);
  if (to_source != nullptr) add(*to_source, emitter, -M);
  const int begin = static_cast<int>(set.entries.size());
  set.entries.push_back({body.layout.sound(), {-distance / (state.sound * state.sound), 0.0, 0.0}});
  gather.emit({z - distance / state.sound, 0.0, 0.0}, variance, board, set, begin);
  return true;
}

}  // namespace

ObservationSet::ObservationSet(const BodyLayout& layout, int most_rows) : most_rows_(most_rows) {
  const auto n = static_cast<std::size_t>(most_rows);
  rows.reserve(n);
  entries.reserve(n * static_cast<std::size_t>(layout.moving() + 10));
  y.reserve(n);
  variance.reserve(n);
  tag.reserve(n);
}

void ObservationSet::clear() noexcept {
  rows.clear();
  entries.clear();
  y.clear();
  variance.clear();
  tag.clear();
}

BodyModel::BodyModel(const Skeleton& canonical, const Garment& garment,
                     std::span<const Eigen::Isometry3d> X_BS)
    : skeleton(canonical),
      layout(canonical, garment),
      fixed(kJointCount, Eigen::Quaterniond::Identity()) {
  if (X_BS.size() != garment.boards.size()) {
    throw std::invalid_argument("wearable filter: not one X_BS per board");
  }
  for (std::size_t b = 0; b < garment.boards.size(); ++b) {
    segment_of.push_back(index(garment.boards[b].segment));
    p_BS.emplace_back(X_BS[b].translation());
  }
  for (const UltrasonicSource& source : garment.sources) {
    source_segment.push_back(source.segment ? std::optional(index(*source.segment)) : std::nullopt);
    X_BU.push_back(source_place(canonical, source));
  }
}

void observe_gyro(const BodyModel& body, const BodyState& state, std::size_t board, double time,
                  const Vector3d& z, double variance, double rate_error,
                  ObservationSet& set) noexcept {
  if (!set.has_room(3)) return;
  PathMotion path;
  evaluate(body.skeleton, body.layout, state, body.fixed, body.segment_of[board], time, path);
  const BoardState& s = state.boards[board];
  const Matrix3d R_SW = (path.end().R * s.q_BS.toRotationMatrix()).transpose();
  const Vector3d w_S = R_SW * path.end().w;
  const auto believed = [&](const Vector3d& w) {
    const double w2 = w.squaredNorm();
    return w2 > 0.0 ? w2 / (w2 + rate_error * rate_error) : 0.0;
  };
  Gatherer gather(body, state, 3);
  for (std::size_t i = 0; i < path.size; ++i) {
    JointBlock block = rate_block(path.joints[i]);
    block.rotation *= believed(path.joints[i].parent_w);
    gather.add(path.joints[i], R_SW, block, time);
  }
  const int begin = static_cast<int>(set.entries.size());
  put_block(body.layout.gyro_bias(board), Matrix3d::Identity(), set);
  put_block(body.layout.mount(board), believed(w_S) * cross_matrix(w_S), set);
  gather.emit(z - w_S - s.gyro_bias, variance, board, set, begin);
}

void observe_accel(const BodyModel& body, const BodyState& state, std::size_t board, double time,
                   const Vector3d& z, double variance, double arm_sigma,
                   ObservationSet& set) noexcept {
  if (!set.has_room(3)) return;
  PathMotion path;
  evaluate(body.skeleton, body.layout, state, body.fixed, body.segment_of[board], time, path);
  double liveliest = 0.0;
  for (std::size_t i = 0; i < path.size; ++i) {
    const JointMotion& joint = path.joints[i];
    const double w2 = joint.w.squaredNorm();
    liveliest = std::max(liveliest, joint.dw.squaredNorm() + w2 * w2);
  }
  variance += arm_sigma * arm_sigma * liveliest;
  const BoardState& s = state.boards[board];
  const PointMotion q = point(path, body.p_BS[board]);
  const Vector3d f_W = q.a + kGravity;
  const Matrix3d R_SW = (path.end().R * s.q_BS.toRotationMatrix()).transpose();
  const Vector3d f_S = R_SW * f_W;
  Gatherer gather(body, state, 3);
  for (std::size_t i = 0; i < path.size; ++i) {
    JointBlock block = acceleration_block(path.joints[i], q);
    turn_along(path.joints[i], f_W, block);
    gather.add(path.joints[i], R_SW, block, time);
  }
  gather.add_root(R_SW, 2, time);
  const int begin = static_cast<int>(set.entries.size());
  put_block(body.layout.accel_bias(board), Matrix3d::Identity(), set);
  put_block(body.layout.mount(board), cross_matrix(f_S), set);
  gather.emit(z - f_S - s.accel_bias, variance, board, set, begin);
}

void observe_field(const BodyModel& body, const BodyState& state, std::size_t board, double time,
                   const Vector3d& z, const Vector3d& f_W, double variance,
                   ObservationSet& set) noexcept {
  if (!set.has_room(3)) return;
  PathMotion path;
  evaluate(body.skeleton, body.layout, state, body.fixed, body.segment_of[board], time, path);
  const Matrix3d R_SW = (path.end().R * state.boards[board].q_BS.toRotationMatrix()).transpose();
  const Vector3d f_S = R_SW * f_W;
  Gatherer gather(body, state, 3);
  for (std::size_t i = 0; i < path.size; ++i) {
    JointBlock block;
    turn_along(path.joints[i], f_W, block);
    gather.add(path.joints[i], R_SW, block, time);
  }
  const int begin = static_cast<int>(set.entries.size());
  put_block(body.layout.mount(board), cross_matrix(f_S), set);
  gather.emit(z - f_S, variance, board, set, begin);
}

bool observe_distance(const BodyModel& body, const BodyState& state, std::size_t source,
                      std::size_t board, double time, double flight, double z, double variance,
                      ObservationSet& set) noexcept {
  if (!set.has_room(1)) return false;
  PathMotion to_board, to_source;
  const double arrival = time + flight;
  evaluate(body.skeleton, body.layout, state, body.fixed, body.segment_of[board], arrival,
           to_board);
  const PointMotion microphone = point(to_board, body.p_BS[board]);
  const Eigen::Isometry3d& X = body.X_BU[source];
  PointMotion emitter{X.translation(), Vector3d::Zero(), Vector3d::Zero()};
  Vector3d normal = X.linear().col(2);
  const bool worn = body.source_segment[source].has_value();
  if (worn) {
    evaluate(body.skeleton, body.layout, state, body.fixed, *body.source_segment[source], time,
             to_source);
    emitter = point(to_source, X.translation());
    normal = to_source.end().R * normal;
  }
  if (normal.dot(microphone.p - emitter.p) <= 0.0) return false;
  return put_distance(body, state, board, to_board, microphone, emitter,
                      worn ? &to_source : nullptr, z, variance, set);
}

void observe_distance_from(const BodyModel& body, const BodyState& state, const Vector3d& p_W,
                           std::size_t board, double time, double z, double variance,
                           ObservationSet& set) noexcept {
  if (!set.has_room(1)) return;
  PathMotion path;
  evaluate(body.skeleton, body.layout, state, body.fixed, body.segment_of[board], time, path);
  (void)put_distance(body, state, board, path, point(path, body.p_BS[board]),
                     {p_W, Vector3d::Zero(), Vector3d::Zero()}, nullptr, z, variance, set);
}

void observe_point(const BodyModel& body, const BodyState& state, PointQuantity quantity,
                   std::size_t segment, const Vector3d& p_BQ, double time, const Vector3d& z,
                   double variance, std::optional<int> axis, ObservationSet& set) noexcept {
  const int rows = axis ? 1 : 3;
  if (!set.has_room(rows)) return;
  PathMotion path;
  evaluate(body.skeleton, body.layout, state, body.fixed, segment, time, path);
  const PointMotion q = point(path, p_BQ);
  const Matrix3d M = axis ? as_row(Vector3d::Unit(*axis)) : Matrix3d::Identity().eval();
  const bool velocity = quantity == PointQuantity::kVelocity;
  Gatherer gather(body, state, rows);
  for (std::size_t i = 0; i < path.size; ++i) {
    const JointMotion& joint = path.joints[i];
    gather.add(joint, M, velocity ? velocity_block(joint, q) : position_block(joint, q), time);
  }
  gather.add_root(M, velocity ? 1 : 0, time);
  gather.emit(M * (z - (velocity ? q.v : q.p)), variance, segment, set,
              static_cast<int>(set.entries.size()));
}

void observe_root_rotation(const BodyModel& body, const BodyState& state, double time,
                           const Eigen::Quaterniond& z, double variance,
                           ObservationSet& set) noexcept {
  if (!set.has_room(3)) return;
  JointMotion root;
  JointBlock block;
  const Eigen::Quaterniond q = after(state.groups[0], time).q;
  const Vector3d innovation = rotation_vector(q.conjugate() * z);
  // d log(q^-1 z) by q's error e: -(left Jacobian)^-1 e, which to first order in the innovation is
  // the right Jacobian's inverse of its negative.
  block.rotation = right_jacobian_inverse(-innovation);
  Gatherer gather(body, state, 3);
  gather.add(root, Matrix3d::Identity(), block, time);
  gather.emit(innovation, variance, 0, set, static_cast<int>(set.entries.size()));
}

void observe_rotation_along(const BodyModel& body, const BodyState& state, int group,
                            const Eigen::Quaterniond& goal, double variance,
                            ObservationSet& set) noexcept {
  if (!set.has_room(1)) return;
  const auto g = static_cast<std::size_t>(group);
  const Vector3d way = rotation_vector(state.groups[g].q.conjugate() * goal);
  const double angle = way.norm();
  if (angle < 1e-9) return;
  JointMotion joint;
  joint.group = group;
  JointBlock block;
  block.rotation = as_row(way / angle);
  Gatherer gather(body, state, 1);
  gather.add(joint, Matrix3d::Identity(), block, 0.0);
  gather.emit({angle, 0.0, 0.0}, variance, g, set, static_cast<int>(set.entries.size()));
}

void observe_columns(int column, const Vector3d& innovation, double variance,
                     ObservationSet& set) noexcept {
  if (!set.has_room(3)) return;
  const int begin = static_cast<int>(set.entries.size());
  put_block(column, Matrix3d::Identity(), set);
  put_rows(begin, innovation, variance, static_cast<std::size_t>(column), set);
}

void observe_likeness(int first, int second, const Vector3d& innovation, double variance,
                      ObservationSet& set) noexcept {
  if (!set.has_room(3)) return;
  const int begin = static_cast<int>(set.entries.size());
  put_block(first, Matrix3d::Identity(), set);
  put_block(second, -Matrix3d::Identity(), set);
  put_rows(begin, innovation, variance, static_cast<std::size_t>(first), set);
}

}  // namespace secondskin::server
