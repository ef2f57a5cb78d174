#pragma once

#include <fmt/core.h>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "coach/correct/correction.h"
#include "motion/rotation.h"
#include "motion/ui_prmd.h"
#include "server/markers/body_fit.h"
#include "server/markers/marker_body.h"
#include "server/markers/marker_set.h"

/// Real errors of real learners, as the problems that the coach would have posed: repetitions of a
/// technique against one another, and wrong executions of physiotherapy exercises against right
/// ones. Learner and expert are aligned offline, so that an aligner's errors do not count.
namespace secondskin::coach {

/// One learner's repetition against one expert's.
struct CorrectionTrial {
  std::shared_ptr<const Reference> reference;
  Skeleton learner;
  std::string cluster;  ///< trials of one cluster share a person or a repetition
  std::vector<CorrectionProblem> problems;
};

struct TrialSet {
  std::string name, unit;  ///< what a cluster is
  std::vector<CorrectionTrial> trials;
};

/// For each learner's frame the expert's of the path that makes the weighted RMS joint angle least;
/// neither goes more than twice as fast as the other, both ends are matched.
inline std::vector<double> aligned_frames(const Reference& expert, const Motion& learner) {
  const std::size_t n = learner.poses.size(), m = expert.motion.poses.size();
  const auto distance = [&](std::size_t i, std::size_t j) {
    double sum = 0.0, weights = 1e-9;
    for (std::size_t k = 1; k < kJointCount; ++k) {
      const Pose& a = learner.poses[i];
      const Pose& b = expert.motion.poses[j];
      if (!(a.confidence[k] > 0.0F) || !(b.confidence[k] > 0.0F)) continue;
      const double d = geodesic_distance(a.q_PB[k], b.q_PB[k]);
      sum += expert.weight[k] * d * d;
      weights += expert.weight[k];
    }
    return std::sqrt(sum / weights);
  };
  constexpr double kFar = std::numeric_limits<double>::infinity();
  struct Cell {
    double cost = kFar;
    std::uint8_t di = 0, dj = 0;
  };
  std::vector<Cell> cells(n * m);
  std::vector<double> local(n * m);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < m; ++j) local[i * m + j] = distance(i, j);
  }
  cells[0].cost = local[0];
  static constexpr std::array<std::array<std::size_t, 2>, 3> kSteps{{{1, 1}, {1, 2}, {2, 1}}};
  for (std::size_t i = 1; i < n; ++i) {
    for (std::size_t j = 1; j < m; ++j) {
      Cell& cell = cells[i * m + j];
      for (const auto [di, dj] : kSteps) {
        if (i < di || j < dj) continue;
        const double cost = cells[(i - di) * m + (j - dj)].cost +
                            0.5 * static_cast<double>(di + dj) * local[i * m + j];
        if (cost < cell.cost) {
          cell = {cost, static_cast<std::uint8_t>(di), static_cast<std::uint8_t>(dj)};
        }
      }
    }
  }
  std::vector<double> path;
  if (!(cells[n * m - 1].cost < kFar)) return path;
  path.assign(n, 0.0);
  std::size_t i = n - 1, j = m - 1;
  for (;;) {
    path[i] = static_cast<double>(j);
    const Cell& cell = cells[i * m + j];
    if (cell.di == 0) break;
    if (cell.di == 2) path[i - 1] = static_cast<double>(j) - 0.5 * cell.dj;
    i -= cell.di;
    j -= cell.dj;
  }
  return path;
}

/// Problems at equal steps through the learner's repetition; both motions at kReferenceRate. Empty
/// where one is more than twice as long as the other.
inline std::vector<CorrectionProblem> problems_of(const Reference& expert, const Motion& learner,
                                                  int count) {
  const std::vector<double> path = aligned_frames(expert, learner);
  std::vector<CorrectionProblem> problems;
  if (path.empty()) return problems;
  const auto n = static_cast<int>(path.size());
  for (int p = 0; p < count; ++p) {
    const int i = (n - 1) * (2 * p + 1) / (2 * count);
    const int before = std::max(0, i - 12), after = std::min(n - 1, i + 12);
    const int last = std::max(0, i - 2), next = std::min(n - 1, i + 2);
    CorrectionProblem problem;
    problem.learner = learner.poses[static_cast<std::size_t>(i)];
    problem.reference_time = path[static_cast<std::size_t>(i)] / kReferenceRate;
    problem.tempo =
        (path[static_cast<std::size_t>(after)] - path[static_cast<std::size_t>(before)]) /
        static_cast<double>(after - before);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const Eigen::Quaterniond& a = learner.poses[static_cast<std::size_t>(last)].q_PB[j];
      const Eigen::Quaterniond& b = learner.poses[static_cast<std::size_t>(next)].q_PB[j];
      problem.velocity[j] =
          rotation_vector(a.conjugate() * b) * kReferenceRate / static_cast<double>(next - last);
    }
    problems.push_back(std::move(problem));
  }
  return problems;
}

/// Repetitions of four karate techniques by one performer (CMU subject 135), each once the expert's
/// and once the learner's; weights and tolerances from `references`. Event times: data README.
inline TrialSet karate_trials(const std::filesystem::path& cmu,
                              const std::filesystem::path& references,
                              const std::filesystem::path& joint_maps, int problems) {
  struct Technique {
    std::string file, reference;
    std::vector<double> events;
    double before, after;  ///< of an event [s]
  };
  const std::vector<Technique> techniques{
      {"135_05_gedanbarai", "low_block", {1.1, 2.8, 4.7, 6.6, 8.8, 10.4, 12.1, 13.9}, 0.9, 0.6},
      {"135_07_mawashigeri", "roundhouse_kick", {1.0, 3.7, 6.4, 9.4}, 0.9, 1.2},
      {"135_09_oiduki", "stepping_punch", {2.5, 4.4, 6.3, 8.2, 10.9, 12.6, 14.2, 15.8}, 0.9, 0.6},
      {"135_10_syutouuke",
       "knife_hand_block",
       {1.9, 3.4, 4.9, 6.4, 8.0, 9.8, 11.4, 12.9, 14.4},
       0.8,
       0.6}};
  TrialSet set{"karate", "learner's repetitions", {}};
  for (const Technique& technique : techniques) {
    const Motion motion =
        resample(read_canonical(cmu / (technique.file + ".bvh"), joint_maps), kReferenceRate);
    const Reference model = load_reference(references / technique.reference, joint_maps);
    std::vector<Motion> repetitions;
    for (const double event : technique.events) {
      const double begin = std::max(0.0, event - technique.before) * kReferenceRate;
      const double end = (event + technique.after) * kReferenceRate;
      repetitions.push_back(slice(motion, static_cast<std::size_t>(begin),
                                  std::min(static_cast<std::size_t>(end), motion.poses.size())));
    }
    for (std::size_t e = 0; e < repetitions.size(); ++e) {
      Reference expert = model;
      expert.motion = repetitions[e];
      expert.band.clear();
      expert.posture = {};
      const auto reference = std::make_shared<const Reference>(std::move(expert));
      for (std::size_t l = 0; l < repetitions.size(); ++l) {
        if (l == e || (l + e) % 2 != 0) continue;  // left and right in turn
        set.trials.push_back({reference, motion.skeleton, fmt::format("{} {}", technique.file, l),
                              problems_of(*reference, repetitions[l], problems)});
      }
    }
  }
  return set;
}

/// Incorrect executions of UI-PRMD's exercises against a correct one of the same or of the next
/// person. Every weight 1, default tolerances. @throws std::runtime_error on files that are no
/// UI-PRMD files, or on markers that are no body.
inline std::vector<TrialSet> rehab_trials(const std::filesystem::path& folder,
                                          const std::filesystem::path& marker_sets, int repetitions,
                                          int problems) {
  struct Exercise {
    std::string code, name;
    bool standing;
  };
  const std::vector<Exercise> exercises{{"m01", "deep squat", true},
                                        {"m05", "sit to stand", false},
                                        {"m07", "shoulder abduction", true}};
  constexpr int kPeople = 10;
  std::vector<TrialSet> sets;
  for (const Exercise& exercise : exercises) {
    TrialSet own{exercise.name + ", own correct execution", "people", {}};
    TrialSet other{exercise.name + ", another person's", "people", {}};
    const auto markers = [&](int person, int repetition,
                             bool correct) -> std::optional<MarkerMotion> {
      const std::filesystem::path file =
          folder / (correct ? "markers_correct" : "markers_incorrect") /
          fmt::format("{}_s{:02}_e{:02}_positions{}.txt.gz", exercise.code, person, repetition,
                      correct ? "" : "_inc");
      if (!std::filesystem::exists(file)) return std::nullopt;
      return read_ui_prmd_markers(file);
    };
    struct Person {
      std::unique_ptr<server::MarkerBody> body;
      std::shared_ptr<const Reference> reference;
    };
    std::vector<Person> people(kPeople + 1);
    const auto fitted = [&](const Person& person, const MarkerMotion& trial) {
      server::BodyFit fit(*person.body);
      Motion motion{fit.skeleton(), trial.rate_hz, {}};
      Pose pose(kJointCount);
      for (const MarkerFrame& frame : trial.frames) {
        (void)fit.update(frame, 1.0 / trial.rate_hz, pose);
        motion.poses.push_back(pose);
      }
      return resample(motion, kReferenceRate);
    };
    for (int p = 1; p <= kPeople; ++p) {
      const auto trial = markers(p, 5, true);
      if (!trial) continue;
      Person& person = people[static_cast<std::size_t>(p)];
      const auto set = server::MarkerSet::choose(marker_sets, trial->names);
      person.body = std::make_unique<server::MarkerBody>(server::calibrate_body(set, *trial).body);
      Reference reference = make_reference(exercise.name, fitted(person, *trial));
      reference.standing = exercise.standing;
      person.reference = std::make_shared<const Reference>(std::move(reference));
    }
    for (int p = 1; p <= kPeople; ++p) {
      const Person& person = people[static_cast<std::size_t>(p)];
      const Person& next = people[static_cast<std::size_t>(p % kPeople + 1)];
      if (!person.body) continue;
      for (int r = 1; r <= repetitions; ++r) {
        const auto trial = markers(p, r, false);
        if (!trial) continue;
        const Motion motion = fitted(person, *trial);
        const std::string cluster = fmt::format("s{:02}", p);
        own.trials.push_back({person.reference, motion.skeleton, cluster,
                              problems_of(*person.reference, motion, problems)});
        if (!next.reference) continue;
        other.trials.push_back({next.reference, motion.skeleton, cluster,
                                problems_of(*next.reference, motion, problems)});
      }
    }
    sets.push_back(std::move(own));
    sets.push_back(std::move(other));
  }
  return sets;
}

}  // namespace secondskin::coach
