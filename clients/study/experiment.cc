#include "clients/study/experiment.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "clients/tactor_driver/driver_core.h"
#include "coach/correct/simulated_source.h"
#include "coach/plan/cue_log.h"
#include "motion/kinematics.h"
#include "motion/rotation.h"
#include "sim/board/virtual_board.h"

namespace secondskin::study {
namespace {

constexpr double kRate = 60.0;        // of the capture system [Hz]
constexpr int kLooksPerFrame = 8;     // at the board: every 2 ms
constexpr double kLatency = 0.010;    // from a pose to its command at the driver [s]
constexpr double kLongestRun = 60.0;  // of a repetition [s]
constexpr std::int64_t kBegin_ns = 1'700'000'000'000'000'000;

// The driver and the board at the two ends of a wire.
class Wire {
 public:
  explicit Wire(const coach::BodyMap& map) : board_(config(map)) { driver_.link_up(0.0); }

  void command(const wire::BoardState& state, std::int64_t stamp_ns, double time) {
    driver_.push({.intensities = state,
                  .stamp_ns = stamp_ns,
                  .valid_for = coach::kCommandLifetime,
                  .number = ++number_},
                 time);
  }
  const std::array<double, wire::kTactorCount>& amplitude(double time) {
    std::array<std::uint8_t, 2 * wire::kSlotCount> bytes;
    const std::size_t count = driver_.next_bytes(time, bytes);
    if (count > 0) board_.receive(std::span(bytes).first(count), time);
    board_.step(time);
    return board_.amplitude();
  }

 private:
  static sim::VirtualBoardConfig config(const coach::BodyMap& map) {
    sim::VirtualBoardConfig config;
    for (const coach::Tactor& tactor : map.tactors) {
      config.actuators[tactor.channel] = tactor.actuator;
    }
    return config;
  }
  tactor_driver::DriverCore driver_;
  sim::VirtualBoard board_;
  std::uint64_t number_ = 0;
};

// The true error, whatever the coach thinks.
class ErrorMeter {
 public:
  ErrorMeter(const coach::Reference& reference, const std::vector<Joint>& joints)
      : reference_(reference), joints_(joints), expert_(kJointCount) {
    using enum Joint;
    constexpr std::array<std::array<Joint, 3>, 5> kLimbs{
        {{kLeftClavicle, kLeftWrist, kLeftWrist},
         {kRightClavicle, kRightWrist, kRightWrist},
         {kLeftHip, kLeftToes, kLeftAnkle},
         {kRightHip, kRightToes, kRightAnkle},
         {kNeck, kHead, kHead}}};
    for (const auto& [first, last, end] : kLimbs) {
      if (std::any_of(joints.begin(), joints.end(),
                      [&](Joint j) { return j >= first && j <= last; })) {
        ends_.push_back(end);
      }
    }
  }

  void take(double reference_time, const Pose& pose) {
    sample(reference_.motion, reference_time, expert_);
    for (const Joint joint : joints_) {
      const std::size_t j = index(joint);
      const double e = geodesic_distance(pose.q_PB[j], expert_.q_PB[j]);
      angles_ += reference_.weight[j] * e * e;
      weights_ += reference_.weight[j];
    }
    const Skeleton& body = reference_.motion.skeleton;
    forward_kinematics(body, Eigen::Vector3d::Zero(), pose.q_PB, X_WB_);
    forward_kinematics(body, Eigen::Vector3d::Zero(), expert_.q_PB, X_WB_expert_);
    for (const Joint joint : ends_) {
      const std::size_t j = index(joint);
      places_ += (X_WB_[j] * body[j].p_BE - X_WB_expert_[j] * body[j].p_BE).squaredNorm();
    }
    ++frames_;
  }
  void finish(Person& person) {
    const double ends = static_cast<double>(std::max<std::size_t>(1, ends_.size() * frames_));
    person.error.push_back(weights_ > 0.0 ? std::sqrt(angles_ / weights_) : 0.0);
    person.place_error.push_back(std::sqrt(places_ / ends));
    angles_ = weights_ = places_ = 0.0;
    frames_ = 0;
  }

 private:
  const coach::Reference& reference_;
  std::vector<Joint> joints_, ends_;
  Pose expert_;
  std::array<Eigen::Isometry3d, kJointCount> X_WB_, X_WB_expert_;
  double angles_ = 0.0, weights_ = 0.0, places_ = 0.0;
  std::size_t frames_ = 0;
};

sim::Lesson lesson(const Protocol& protocol) {
  sim::Lesson lesson;
  lesson.reference = &protocol.reference->motion;
  lesson.weight = protocol.reference->weight;
  lesson.repulsive = protocol.map.repulsive;
  for (const coach::Tactor& tactor : protocol.map.tactors) {
    lesson.tactors.push_back({tactor.channel, tactor.segment, tactor.angle});
  }
  return lesson;
}

coach::Feedback none() {
  coach::Feedback feedback;
  feedback.joints.reset();
  return feedback;
}

}  // namespace

std::shared_ptr<const coach::Reference> of_worn_joints(const coach::Reference& reference,
                                                       const coach::BodyMap& map) {
  auto worn = std::make_shared<coach::Reference>(reference);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (std::none_of(map.tactors.begin(), map.tactors.end(),
                     [&](const coach::Tactor& t) { return index(t.segment) == j; })) {
      worn->weight[j] = 0.0;
    }
  }
  return worn;
}

std::vector<Joint> served(const Protocol& protocol) {
  const coach::JointSet told = coach::TactileMapper(protocol.map).served();
  std::vector<Joint> joints;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (told[j] && protocol.reference->weight[j] > 0.0) joints.push_back(static_cast<Joint>(j));
  }
  return joints;
}

Person run_person(const Protocol& protocol, Group group, std::uint64_t seed,
                  const std::vector<coach::GivenCue>& cues) {
  const auto& reference = protocol.reference;
  sim::VirtualLearner learner(lesson(protocol), protocol.learner, seed);
  // Whoever is not cued by the own error needs no solver: nothing would come of its results.
  std::unique_ptr<coach::CorrectionSource> source;
  if (group == Group::kTactile) {
    source = std::make_unique<coach::SimulatedSource>(
        reference, reference->motion.skeleton,
        coach::CorrectionOptions{.tolerance_scale = protocol.settings.tolerance_scale,
                                 .max_joints = protocol.settings.max_cues});
  } else {
    source = std::make_unique<coach::NoSource>();
  }
  coach::TactileSetup tactile;
  tactile.endless = protocol.endless_cues;
  coach::Coach coach(reference, protocol.map, protocol.settings, *source, tactile);
  coach.feedback(none());
  Wire wire(protocol.map);
  ErrorMeter meter(*reference, served(protocol));
  coach::CueLog log;
  coach::CoachOutput out;
  Person person;
  std::vector<coach::Outcome> outcomes;
  coach::FeedbackSchedule sham{.kind = coach::FeedbackSchedule::Kind::kYoked};
  sham.cues = cues;

  // What holds from the n-th repetition on.
  const auto begin = [&](std::size_t n) {
    const bool practice = n >= protocol.before && n < protocol.before + protocol.practice;
    learner.see(practice);
    if (!practice || group == Group::kVisual) {
      coach.feedback(none());
    } else {
      coach.feedback(coach::decide(group == Group::kSham ? sham : protocol.schedule, seed, outcomes,
                                   protocol.practice, static_cast<std::uint32_t>(n),
                                   reference->weight));
    }
  };
  begin(0);

  double time = 0.0, began = 0.0;
  std::uint64_t frame = 0;
  std::size_t done = 0;
  std::optional<coach::RepetitionScore> score;
  while (done < protocol.repetitions() && time - began < kLongestRun) {
    const Pose& pose = learner.move(time);
    if (learner.repetitions() > done) {
      meter.finish(person);
      outcomes.emplace_back();
      if (score) {
        for (std::size_t j = 0; j < kJointCount; ++j) {
          outcomes.back().in_band[j] = score->joints[j].in_band;
        }
      }
      if (learner.repetitions() == protocol.before) outcomes.clear();
      score.reset();
      done = learner.repetitions();
      if (done == protocol.before + protocol.practice) {
        learner.rest(protocol.rest);
        time += protocol.rest;
      }
      began = time;
      begin(done);
    }
    if (const auto at = learner.reference_time()) meter.take(*at, pose);

    const std::int64_t stamp_ns = kBegin_ns + std::llround(time * 1e9);
    coach.step({++frame, stamp_ns, pose}, out);
    coach.pose_problem();
    log.take(static_cast<std::uint32_t>(done),
             out.alignment.reference_time / reference->motion.duration(), coach.cues(),
             out.correction, out.error, coach.tolerance());
    if (out.repetition) {
      score = out.repetition;
      ++person.counted;
    }
    for (int look = 0; look < kLooksPerFrame; ++look) {
      const double now = time + (look + 1) / (kRate * kLooksPerFrame);
      if (look == static_cast<int>(kLatency * kRate * kLooksPerFrame)) {
        wire.command(out.tactors, stamp_ns, now);
      }
      learner.feel(now, wire.amplitude(now));
    }
    time += 1.0 / kRate;
  }
  person.cues = coach.cues_given();
  person.reactions = learner.reactions();
  person.right = learner.right();
  person.wrong = learner.wrong();
  person.given = log.cues();
  return person;
}

}  // namespace secondskin::study
