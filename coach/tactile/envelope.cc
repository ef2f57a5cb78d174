#include "coach/tactile/envelope.h"

#include <cmath>
#include <utility>

namespace secondskin::coach {
namespace {

constexpr std::size_t kGroups = wire::kTactorCount / 4;

template <std::size_t... I>
std::array<wire::ActuatorResponse, wire::kTactorCount> make_responses(
    const std::array<wire::Actuator, wire::kTactorCount>& kinds,
    std::index_sequence<I...>) noexcept {
  return {wire::ActuatorResponse(kinds[I])...};
}

void take(wire::BoardState board, double time, wire::BoardPatterns& patterns) noexcept {
  for (std::size_t group = 0; group < kGroups; ++group) {
    std::uint8_t& forward = board[wire::saltation_slot(group, false)];
    std::uint8_t& reverse = board[wire::saltation_slot(group, true)];
    if (forward != 0 && reverse != 0) (forward >= reverse ? reverse : forward) = 0;
  }
  // Off first, so that turning one direction off does not end the other.
  for (const bool on : {false, true}) {
    for (std::size_t slot = 0; slot < wire::kSlotCount; ++slot) {
      if ((board[slot] >= wire::kFaintestIntensity) == on)
        patterns.apply({slot, board[slot]}, time);
    }
  }
}

}  // namespace

void render_envelope(std::span<const TimedCommand> commands,
                     const std::array<wire::Actuator, wire::kTactorCount>& actuators, double from,
                     double step, std::span<EnvelopeSample> out) noexcept {
  wire::BoardPatterns patterns;
  auto responses = make_responses(actuators, std::make_index_sequence<wire::kTactorCount>());
  std::size_t next = 0;
  double lapses_at = -INFINITY;
  for (std::size_t i = 0; i < out.size(); ++i) {
    const double now = from + step * static_cast<double>(i);
    for (; next < commands.size() && !(commands[next].time > now); ++next) {
      const TimedCommand& command = commands[next];
      if (!std::isfinite(command.time) || !(command.valid_for > 0.0)) continue;
      if (command.time >= lapses_at) patterns.all_off();
      lapses_at = command.time + command.valid_for;
      take(command.board, command.time, patterns);
    }
    if (now >= lapses_at) patterns.all_off();
    patterns.drive(now, out[i].drive);
    for (std::size_t t = 0; t < wire::kTactorCount; ++t) {
      out[i].vibration[t] = responses[t].step(out[i].drive[t], i == 0 ? 0.0 : step);
    }
  }
}

}  // namespace secondskin::coach
