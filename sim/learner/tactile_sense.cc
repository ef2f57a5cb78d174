#include "sim/learner/tactile_sense.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace secondskin::sim {
namespace {

constexpr double kSilence = 0.15;    // longer than any pause within a pattern of the board [s]
constexpr double kListening = 0.25;  // what is understood is what was felt for so long [s]
constexpr double kTap = 0.12;        // what lasts longer is no tap [s]
constexpr double kShortest = 0.001;  // that a contact counts for [s]
constexpr double kRemembered = 2.0;  // [s]

double wrapped(double angle) noexcept { return std::remainder(angle, 2.0 * std::numbers::pi); }

}  // namespace

TactileSense::TactileSense(std::vector<WornTactor> tactors, const LearnerParameters& parameters,
                           std::uint64_t seed)
    : tactors_(std::move(tactors)), p_(parameters), random_(seed) {
  for (const WornTactor& tactor : tactors_) {
    const auto known = std::find_if(segments_.begin(), segments_.end(),
                                    [&](const Segment& s) { return s.joint == tactor.segment; });
    segment_of_.push_back(static_cast<std::size_t>(known - segments_.begin()));
    if (known == segments_.end()) segments_.push_back({.joint = tactor.segment, .contacts = {}});
  }
}

void TactileSense::feel(double time, const std::array<double, wire::kTactorCount>& amplitude) {
  for (std::size_t t = 0; t < tactors_.size(); ++t) {
    Segment& segment = segments_[segment_of_[t]];
    const double level = amplitude[tactors_[t].channel];
    const auto open = std::find_if(segment.contacts.begin(), segment.contacts.end(),
                                   [&](const Contact& c) { return c.tactor == t && !c.over; });
    if (!(level >= p_.threshold)) {
      if (open != segment.contacts.end()) open->over = true;
      continue;
    }
    if (open != segment.contacts.end()) {
      open->end = time;
      open->peak = std::max(open->peak, level);
    } else {
      if (!segment.expects && time - segment.last_felt > kSilence) {
        std::normal_distribution<double> deviation(0.0, p_.reaction_deviation);
        const double mean = p_.reaction_time + p_.second_task + location_delay(segment.joint);
        // Nobody reacts in less than half of the usual time.
        segment.reaction = std::max(0.5 * mean, mean + deviation(random_));
        segment.due = time + segment.reaction;
        segment.expects = true;
      }
      segment.contacts.push_back({t, time, time, level, false});
      ++contacts_felt_;
    }
    segment.last_felt = time;
  }
  for (Segment& segment : segments_) {
    std::erase_if(segment.contacts,
                  [&](const Contact& c) { return c.over && time - c.end > kRemembered; });
  }
}

std::optional<FeltCue> TactileSense::understand(const Segment& segment, double from,
                                                double to) const {
  std::vector<Contact> felt;
  for (const Contact& contact : segment.contacts) {
    if (contact.end >= from && contact.begin <= to) felt.push_back(contact);
  }
  if (felt.empty()) return std::nullopt;
  // Two at once are one between them; taps that go from place to place are a turn.
  bool together = false;
  int hops = 0;
  for (std::size_t i = 1; i < felt.size(); ++i) {
    const Contact &before = felt[i - 1], &next = felt[i];
    if (before.tactor == next.tactor) continue;
    // An actuator that dies away while the next one starts is not felt with it.
    const double overlap = std::min(before.end, next.end) - next.begin;
    const double shorter = std::min(before.end - before.begin, next.end - next.begin);
    if (overlap > 0.5 * shorter) together = true;
    if (before.end - before.begin > kTap || next.end - next.begin > kTap) continue;
    const double step = wrapped(tactors_[next.tactor].angle - tactors_[before.tactor].angle);
    if (std::abs(step) < 0.75 * std::numbers::pi) hops += step > 0.0 ? 1 : -1;
  }
  FeltCue cue;
  cue.segment = segment.joint;
  cue.felt = from;
  cue.rotation = !together && hops != 0;
  cue.positive = hops > 0;
  // Energy, as two tactors are felt as one: Israr & Poupyrev 2011. Over time, so that the beginning
  // of the next cue does not outweigh this one.
  double x = 0.0, y = 0.0, most = 0.0, strongest = 0.0, amplitudes = 0.0;
  for (std::size_t t = 0; t < tactors_.size(); ++t) {
    double peak = 0.0, energy = 0.0;
    for (const Contact& contact : felt) {
      if (contact.tactor != t) continue;
      const double lasted = std::min(contact.end, to) - std::max(contact.begin, from);
      peak = std::max(peak, contact.peak);
      energy += contact.peak * contact.peak * std::max(lasted, kShortest);
    }
    x += energy * std::cos(tactors_[t].angle);
    y += energy * std::sin(tactors_[t].angle);
    amplitudes += peak * peak;
    if (energy > most) {
      most = energy;
      strongest = peak;
    }
  }
  cue.angle = std::atan2(y, x);
  cue.strength = together ? std::min(1.0, std::sqrt(amplitudes)) : strongest;
  return cue;
}

std::vector<FeltCue> TactileSense::react(double time) {
  std::vector<FeltCue> cues;
  const auto at_once = std::count_if(segments_.begin(), segments_.end(), [&](const Segment& s) {
    return s.expects && time - s.last_felt <= kSilence;
  });
  const double extra = static_cast<double>(std::max<std::ptrdiff_t>(0, at_once - 1));
  // All of n are told with this probability; each of them with its n-th root.
  const double all = std::max(0.05, 1.0 - p_.misread - p_.misread_with_each * extra);
  const double told = std::pow(all, 1.0 / (1.0 + extra));
  std::uniform_real_distribution<double> uniform;
  std::normal_distribution<double> normal;
  for (Segment& segment : segments_) {
    if (!segment.expects || time < segment.due) continue;
    const double from = segment.due - segment.reaction;
    auto cue = understand(segment, from, std::min(from + kListening, time));
    if (!cue) {
      segment.expects = false;
      continue;
    }
    segment.due += p_.refractory;
    // Drawn whatever comes of it, so that people differ in nothing but what is asked.
    const double notice = uniform(random_), right = uniform(random_), side = uniform(random_);
    cue->strength = std::clamp(cue->strength * (1.0 + p_.weber * normal(random_)), 0.0, 1.0);
    if (notice < p_.missed) continue;
    if (right >= told) {
      cue->angle = wrapped(cue->angle + (side < 0.5 ? 0.5 : -0.5) * std::numbers::pi);
      cue->positive = !cue->positive;
    }
    cues.push_back(*cue);
  }
  return cues;
}

}  // namespace secondskin::sim
