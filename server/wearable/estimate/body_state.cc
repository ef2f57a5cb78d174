#include "server/wearable/estimate/body_state.h"

#include <cassert>

#include "motion/rotation.h"

namespace secondskin::server {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

Vector3d at(std::span<const double> error, int column) noexcept {
  return Eigen::Map<const Vector3d>(error.data() + column);
}

}  // namespace

GroupState after(const GroupState& group, double time) noexcept {
  GroupState result = group;
  if (time == 0.0) return result;
  const Vector3d turned = time * group.w + 0.5 * time * time * group.dw;
  result.q = (group.q * quaternion_from(turned)).normalized();
  result.w += time * group.dw;
  return result;
}

GroupTransition transition(const GroupState& group, double time) noexcept {
  const Vector3d turned = time * group.w + 0.5 * time * time * group.dw;
  return {quaternion_from(-turned).toRotationMatrix(), right_jacobian(turned)};
}

Eigen::Matrix3d white_jerk(double time) noexcept {
  const double t2 = time * time, t3 = t2 * time;
  Eigen::Matrix3d Q;
  Q << t3 * t2 / 20.0, t2 * t2 / 8.0, t3 / 6.0,  //
      t2 * t2 / 8.0, t3 / 3.0, t2 / 2.0,         //
      t3 / 6.0, t2 / 2.0, time;
  return Q;
}

void propagate(BodyState& state, double time) noexcept {
  state.p += time * state.v + 0.5 * time * time * state.a;
  state.v += time * state.a;
  for (GroupState& group : state.groups) group = after(group, time);
}

void correct(const BodyLayout& layout, std::span<const double> error, BodyState& state) noexcept {
  assert(static_cast<int>(error.size()) >= layout.size());
  state.p += at(error, layout.root(0));
  state.v += at(error, layout.root(1));
  state.a += at(error, layout.root(2));
  for (int g = 0; g < layout.groups; ++g) {
    GroupState& group = state.groups[static_cast<std::size_t>(g)];
    group.q = (group.q * quaternion_from(at(error, layout.rotation(g, 0)))).normalized();
    group.w += at(error, layout.rotation(g, 1));
    group.dw += at(error, layout.rotation(g, 2));
  }
  for (std::size_t b = 0; b < state.boards.size(); ++b) {
    BoardState& board = state.boards[b];
    board.gyro_bias += at(error, layout.gyro_bias(b));
    board.accel_bias += at(error, layout.accel_bias(b));
    board.q_BS = (board.q_BS * quaternion_from(at(error, layout.mount(b)))).normalized();
  }
  state.sound += error[static_cast<std::size_t>(layout.sound())];
}

void difference(const BodyLayout& layout, const BodyState& state, const BodyState& estimate,
                std::span<double> error) noexcept {
  assert(static_cast<int>(error.size()) >= layout.size());
  const auto put = [&](int column, const Vector3d& v) {
    Eigen::Map<Vector3d>(error.data() + column) = v;
  };
  put(layout.root(0), state.p - estimate.p);
  put(layout.root(1), state.v - estimate.v);
  put(layout.root(2), state.a - estimate.a);
  for (int g = 0; g < layout.groups; ++g) {
    const GroupState& s = state.groups[static_cast<std::size_t>(g)];
    const GroupState& e = estimate.groups[static_cast<std::size_t>(g)];
    put(layout.rotation(g, 0), rotation_vector(e.q.conjugate() * s.q));
    put(layout.rotation(g, 1), s.w - e.w);
    put(layout.rotation(g, 2), s.dw - e.dw);
  }
  for (std::size_t b = 0; b < state.boards.size(); ++b) {
    const BoardState& s = state.boards[b];
    const BoardState& e = estimate.boards[b];
    put(layout.gyro_bias(b), s.gyro_bias - e.gyro_bias);
    put(layout.accel_bias(b), s.accel_bias - e.accel_bias);
    put(layout.mount(b), rotation_vector(e.q_BS.conjugate() * s.q_BS));
  }
  error[static_cast<std::size_t>(layout.sound())] = state.sound - estimate.sound;
}

}  // namespace secondskin::server
