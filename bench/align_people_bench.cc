// Are other people followed, also those who do it wrongly? UI-PRMD's three exercises by ten people,
// correct and incorrect, in references by others: one repetition of another person, and the mean of
// three other people's. A single repetition must be counted exactly once, and the ten of a person
// joined (over half a second) ten times. docs/alignment.md quotes the output.
//
// The data set's files end as the person arrives: `as is` gives the file alone, `held` its last
// pose for half a second more, as if the person then stood there.

#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "coach/align/aligner.h"
#include "motion/marker_file.h"
#include "server/markers/marker_source.h"

#ifndef SECONDSKIN_SOURCE_DIR
#define SECONDSKIN_SOURCE_DIR "."
#endif

namespace {

using namespace secondskin;
using namespace secondskin::coach;

constexpr double kLearnerRate = 62.5;       // [Hz], the paper's
constexpr double kHold = 0.5, kJoin = 0.5;  // [s]

struct Exercise {
  const char* id;
  const char* reference;      // that has its weights
  std::vector<int> mirrored;  // people who do it with the other arm
};
const std::array<Exercise, 3> kExercises{{{"m01", "deep_squat", {}},
                                          {"m05", "sit_to_stand", {}},
                                          {"m07", "shoulder_abduction", {7, 10}}}};

// [person][repetition]; a repetition that is not there is left out.
using People = std::vector<std::vector<Motion>>;

People load(const std::filesystem::path& data, const server::MarkerSet& set,
            const Exercise& exercise, bool correct, int people, int repetitions) {
  People result;
  for (int person = 1; person <= people; ++person) {
    const bool other_arm = std::find(exercise.mirrored.begin(), exercise.mirrored.end(), person) !=
                           exercise.mirrored.end();
    result.emplace_back();
    for (int repetition = 1; repetition <= repetitions; ++repetition) {
      const auto file = data / (correct ? "markers_correct" : "markers_incorrect") /
                        fmt::format("{}_s{:02}_e{:02}_positions{}.txt.gz", exercise.id, person,
                                    repetition, correct ? "" : "_inc");
      if (!std::filesystem::exists(file)) continue;
      server::MarkerSource source(read_markers(file), set);
      Motion motion{source.skeleton(), source.rate_hz(), {}};
      for (StampedPose pose; source.next(pose) == server::Next::kPose;) {
        motion.poses.push_back(pose.pose);
      }
      if (other_arm) motion = mirrored(make_reference("other arm", motion)).motion;
      result.back().push_back(resample(motion, kLearnerRate));
    }
  }
  return result;
}

Motion join(const std::vector<Motion>& parts) {
  Motion whole = parts.front();
  const int steps = static_cast<int>(kJoin * kLearnerRate);
  for (std::size_t k = 1; k < parts.size(); ++k) {
    const Pose from = whole.poses.back(), to = parts[k].poses.front();
    for (int i = 1; i < steps; ++i) {
      Pose between(kJointCount);
      interpolate(from, to, static_cast<double>(i) / steps, between);
      whole.poses.push_back(between);
    }
    whole.poses.insert(whole.poses.end(), parts[k].poses.begin(), parts[k].poses.end());
  }
  return whole;
}

struct Followed {
  int finished = 0, finished_held = 0;
  bool lost = false;
};

Followed follow(const std::shared_ptr<const Reference>& reference, const Motion& learner) {
  Aligner aligner(reference);
  const std::size_t n = learner.poses.size();
  Followed result;
  Phase before = Phase::kWaiting;
  for (std::size_t i = 0; i < n + static_cast<std::size_t>(kHold * kLearnerRate); ++i) {
    const auto stamp =
        static_cast<std::int64_t>(1e9 * (1.0 + static_cast<double>(i) / kLearnerRate));
    const auto e = aligner.update(stamp, learner.poses[std::min(i, n - 1)]);
    if (e.phase == Phase::kFinished && before != Phase::kFinished) {
      ++result.finished_held;
      if (i < n) ++result.finished;
    }
    if (i < n && e.phase == Phase::kLost) result.lost = true;
    before = e.phase;
  }
  return result;
}

struct Tally {
  int files = 0, once = 0, once_held = 0, twice = 0, lost = 0;
  int series = 0, right = 0, counted = 0, truth = 0;

  void add(const std::shared_ptr<const Reference>& reference, const std::vector<Motion>& person) {
    for (const Motion& repetition : person) {
      const Followed f = follow(reference, repetition);
      ++files;
      once += f.finished == 1;
      once_held += f.finished_held == 1;
      twice += f.finished_held > 1;
      lost += f.lost;
    }
    const Followed f = follow(reference, join(person));
    const int n = static_cast<int>(person.size());
    ++series;
    right += f.finished_held == n;
    counted += f.finished_held;
    truth += n;
  }
};

double percent(int part, int whole) { return whole == 0 ? 0.0 : 100.0 * part / whole; }

}  // namespace

int main(int argc, char** argv) {
  namespace fs = std::filesystem;
  CLI::App app{
      "Alignment: other people's repetitions, correct and incorrect, followed and counted"};
  bool json = false;
  int people = 10, repetitions = 10;
  fs::path repository = SECONDSKIN_SOURCE_DIR;
  fs::path data = repository / ".." / "shared" / "data";
  app.add_flag("--json", json, "print JSON");
  app.add_option("--people", people, "of UI-PRMD, 4 to 10")->check(CLI::Range(4, 10));
  app.add_option("--repetitions", repetitions, "of each, 2 to 10")->check(CLI::Range(2, 10));
  app.add_option("--repository", repository, "where reference_motions and marker_sets are");
  app.add_option("--data", data, "the recordings that are not shipped");
  CLI11_PARSE(app, argc, argv);
  data = data / "rehab" / "ui-prmd";
  if (!fs::exists(data)) {
    fmt::print("{}: not there\n", data.string());
    return 0;
  }
  const auto set = server::MarkerSet::load(repository / "marker_sets" / "plug_in_gait.toml");
  auto all = nlohmann::json::array();
  if (!json) {
    fmt::print("{:<20} {:<10} {:<10} {:>6} {:>7} {:>7} {:>6} {:>6} {:>9} {:>12}\n", "exercise",
               "reference", "executions", "files", "as is %", "held %", "twice", "lost %",
               "joined ok", "counted");
  }
  for (const Exercise& exercise : kExercises) {
    const Reference shipped = load_reference(repository / "reference_motions" / exercise.reference,
                                             repository / "joint_maps");
    const People correct = load(data, set, exercise, true, people, repetitions);
    const People incorrect = load(data, set, exercise, false, people, repetitions);
    const auto n = correct.size();
    for (const std::size_t experts : {std::size_t{1}, std::size_t{3}}) {
      std::array<Tally, 2> tally;
      for (std::size_t r = 0; r < n; ++r) {
        std::vector<Motion> performances;
        std::vector<bool> is_expert(n);
        for (std::size_t k = 0; k < experts; ++k) {
          const std::size_t expert = (r + k * 3) % n;
          if (is_expert[expert] || correct[expert].size() < 2) continue;
          is_expert[expert] = true;
          performances.push_back(resample(correct[expert][1], kReferenceRate));
        }
        if (performances.empty()) continue;
        Reference reference = make_reference(exercise.reference, performances);
        reference.weight = shipped.weight;
        const auto shared = std::make_shared<const Reference>(std::move(reference));
        for (std::size_t person = 0; person < n; ++person) {
          if (is_expert[person]) continue;
          if (!correct[person].empty()) tally[0].add(shared, correct[person]);
          if (!incorrect[person].empty()) tally[1].add(shared, incorrect[person]);
        }
      }
      for (std::size_t k = 0; k < 2; ++k) {
        const Tally& t = tally[k];
        const std::string of = experts == 1 ? "one other" : "3 others";
        const std::string executions = k == 0 ? "correct" : "incorrect";
        all.push_back({{"exercise", exercise.reference},
                       {"reference", of},
                       {"executions", executions},
                       {"files", t.files},
                       {"counted_once", percent(t.once, t.files)},
                       {"counted_once_held", percent(t.once_held, t.files)},
                       {"counted_more_often", t.twice},
                       {"with_lost_frames", percent(t.lost, t.files)},
                       {"series", t.series},
                       {"series_right", t.right},
                       {"counted", t.counted},
                       {"truth", t.truth}});
        if (json) continue;
        fmt::print("{:<20} {:<10} {:<10} {:>6} {:>7.1f} {:>7.1f} {:>6} {:>6.1f} {:>9} {:>12}\n",
                   exercise.reference, of, executions, t.files, percent(t.once, t.files),
                   percent(t.once_held, t.files), t.twice, percent(t.lost, t.files),
                   fmt::format("{}/{}", t.right, t.series),
                   fmt::format("{}/{}", t.counted, t.truth));
        std::fflush(stdout);
      }
    }
  }
  if (json) fmt::print("{}\n", all.dump(2));
  return 0;
}
