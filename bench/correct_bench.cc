// How long does a correction take, and where does the time go? A learner who does a real reference
// motion with slowly changing errors, solved as in a live session: at the coach's 15 problems a
// second, at every frame of a 62.5 Hz source, and cold. docs/correction.md quotes the output.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "coach/correct/correction.h"
#include "coach/correct/correction_model.h"
#include "motion/rotation.h"

#ifndef SECONDSKIN_SOURCE_DIR
#define SECONDSKIN_SOURCE_DIR "."
#endif

namespace {

using namespace secondskin;
using namespace secondskin::coach;
using Clock = std::chrono::steady_clock;

constexpr double kDegree = std::numbers::pi / 180.0;

double thread_cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

// The errors of one learner: every joint strays a little, some joints a lot.
class Learner {
 public:
  Learner(const Reference& reference, double stray, double mistake, unsigned seed)
      : reference_(reference), now_(kJointCount), next_(kJointCount) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> phase(0.0, 2.0 * std::numbers::pi);
    std::uniform_real_distribution<double> frequency(0.1, 0.6);
    std::vector<std::size_t> joints;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      if (reference.weight[j] > 0.0) joints.push_back(j);
      for (int k = 0; k < 3; ++k) {
        phase_[j][k] = phase(random);
        frequency_[j][k] = frequency(random);
        amount_[j] = stray;
      }
    }
    std::shuffle(joints.begin(), joints.end(), random);
    for (std::size_t n = 0; n < std::min<std::size_t>(3, joints.size()); ++n) {
      amount_[joints[n]] = mistake;
    }
  }

  CorrectionProblem at(double t) {
    const double duration = reference_.motion.duration();
    const double reference_time = duration > 0.0 ? std::fmod(t, duration) : 0.0;
    constexpr double kStep = 1.0 / 62.5;
    pose(reference_time, t, now_);
    pose(reference_time + kStep, t + kStep, next_);
    CorrectionProblem problem;
    problem.reference_time = reference_time;
    problem.learner = now_;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      problem.velocity[j] = rotation_vector(now_.q_PB[j].conjugate() * next_.q_PB[j]) / kStep;
    }
    return problem;
  }

 private:
  void pose(double reference_time, double t, Pose& out) const {
    sample(reference_.motion, reference_time, out);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      Eigen::Vector3d e;
      for (int k = 0; k < 3; ++k) {
        e[k] = amount_[j] * std::sin(2.0 * std::numbers::pi * frequency_[j][k] * t + phase_[j][k]);
      }
      out.q_PB[j] = out.q_PB[j] * quaternion_from(e);
    }
  }

  const Reference& reference_;
  Pose now_, next_;
  std::array<Eigen::Vector3d, kJointCount> phase_, frequency_;
  std::array<double, kJointCount> amount_{};
};

struct Series {
  std::string name;
  std::vector<double> wall, cpu;
  std::vector<std::uint32_t> iterations;
  std::array<std::size_t, 4> status{};
  std::size_t asked = 0;

  void add(const CorrectionResult& result, double cpu_time) {
    wall.push_back(result.solve_time);
    cpu.push_back(cpu_time);
    iterations.push_back(result.iterations);
    ++status[static_cast<std::size_t>(result.status)];
    for (const Eigen::Vector3d& v : result.target) asked += v.isZero() ? 0 : 1;
  }
};

template <typename T>
double quantile(std::vector<T> values, double q) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return static_cast<double>(
      values[static_cast<std::size_t>(q * static_cast<double>(values.size() - 1) + 0.5)]);
}

nlohmann::json report(const Series& s) {
  const auto n = static_cast<double>(s.wall.size());
  const auto times = [](const std::vector<double>& t) {
    return nlohmann::json{{"p50", 1e3 * quantile(t, 0.5)},
                          {"p90", 1e3 * quantile(t, 0.9)},
                          {"p99", 1e3 * quantile(t, 0.99)},
                          {"max", 1e3 * quantile(t, 1.0)}};
  };
  std::array<std::size_t, 16> histogram{};
  for (const double t : s.wall) {
    ++histogram[static_cast<std::size_t>(std::clamp(1e3 * t, 0.0, 15.0))];
  }
  return {{"name", s.name},
          {"solves", s.wall.size()},
          {"wall_ms", times(s.wall)},
          {"cpu_ms", times(s.cpu)},
          {"iterations",
           {{"p50", quantile(s.iterations, 0.5)},
            {"p99", quantile(s.iterations, 0.99)},
            {"max", quantile(s.iterations, 1.0)}}},
          {"converged", static_cast<double>(s.status[1]) / n},
          {"deadline", static_cast<double>(s.status[2]) / n},
          {"fallback", static_cast<double>(s.status[3]) / n},
          {"joints_asked", static_cast<double>(s.asked) / n},
          {"histogram_ms", histogram}};
}

double mean_time(const std::function<void(int)>& work) {
  constexpr int kTimes = 2000;
  const double start = thread_cpu_time();
  for (int i = 0; i < kTimes; ++i) work(i);
  return (thread_cpu_time() - start) / kTimes;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Solve times of the correction over a moving sequence"};
  const std::filesystem::path root = SECONDSKIN_SOURCE_DIR;
  std::filesystem::path reference_path = root / "reference_motions" / "squat";
  std::filesystem::path joint_maps = root / "joint_maps";
  double seconds = 100.0, stray_deg = 6.0, mistake_deg = 25.0;
  unsigned seed = 1;
  bool standing = false, json = false;
  app.add_option("--reference", reference_path, "folder or motion file");
  app.add_option("--joint-maps", joint_maps);
  app.add_option("--seconds", seconds, "of the session");
  app.add_option("--stray", stray_deg, "amplitude of every joint's error [deg]");
  app.add_option("--mistake", mistake_deg, "amplitude of three joints' error [deg]");
  app.add_option("--seed", seed);
  app.add_flag("--standing", standing, "balance counts, whatever the reference says");
  app.add_flag("--json", json);
  CLI11_PARSE(app, argc, argv);

  Reference loaded = load_reference(reference_path, joint_maps);
  loaded.standing = loaded.standing || standing;
  const auto reference = std::make_shared<const Reference>(std::move(loaded));
  const Skeleton body = canonical_skeleton(1.65);
  Learner learner(*reference, stray_deg * kDegree, mistake_deg * kDegree, seed);

  std::vector<Series> all;
  const auto run = [&](const std::string& name, double rate_hz, bool cold) {
    Series series;
    series.name = name;
    auto solver = std::make_unique<CorrectionSolver>(reference, body);
    const auto count = static_cast<int>(cold ? 100 : seconds * rate_hz);
    for (int i = 0; i < count; ++i) {
      if (cold) solver = std::make_unique<CorrectionSolver>(reference, body);
      const CorrectionProblem problem = learner.at(cold ? seconds * i / count : i / rate_hz);
      const double before = thread_cpu_time();
      const CorrectionResult result = solver->solve(problem);
      series.add(result, thread_cpu_time() - before);
    }
    all.push_back(std::move(series));
  };
  run("15 problems a second, warm", 15.0, false);
  run("62.5 problems a second, warm", 62.5, false);
  run("cold", 0.0, true);

  CorrectionModel model(reference, body, {});
  const CorrectionProblem problem = learner.at(1.0);
  (void)model.pose(problem);
  const std::size_t n = model.size();
  std::vector<double> delta(n, 0.0), gradient(n), hessian(n * n);
  const auto fresh = [&](int i) { delta[0] = 1e-7 * i; };  // or the model answers from memory
  const std::vector<std::pair<std::string, double>> parts{
      {"pose (prediction, bounds)", mean_time([&](int) { (void)model.pose(problem); })},
      {"objective", mean_time([&](int i) { fresh(i), (void)model.cost(delta); })},
      {"objective + gradient",
       mean_time([&](int i) { fresh(i), model.gradient(delta, gradient); })},
      {"objective + Hessian", mean_time([&](int i) { fresh(i), model.hessian(delta, hessian); })}};

  if (json) {
    nlohmann::json out{{"reference", reference->name},
                       {"degrees_of_freedom", n},
                       {"knots", kKnots},
                       {"balance_constraints", model.constraints()}};
    for (const Series& series : all) out["series"].push_back(report(series));
    for (const auto& [name, time] : parts) out["model_us"][name] = 1e6 * time;
    fmt::print("{}\n", out.dump(2));
    return 0;
  }
  fmt::print("{}: {} degrees of freedom, {} knots, {} balance constraints\n\n", reference->name, n,
             kKnots, model.constraints());
  fmt::print(
      "{:<30} {:>6} | {:>6} {:>6} {:>6} {:>6} | {:>6} {:>6} | {:>4} {:>4} | {:>5} {:>5} {:>5} | "
      "{:>5}\n",
      "", "solves", "p50", "p90", "p99", "max", "p50", "p99", "p50", "p99", "conv", "dead", "fall",
      "asked");
  fmt::print("{:<30} {:>6} | {:>27} | {:>13} | {:>9} | {:>17} | {:>5}\n", "", "", "wall [ms]",
             "CPU [ms]", "iter", "share [%]", "joint");
  for (const Series& series : all) {
    const auto r = report(series);
    const auto percent = [&](const char* key) { return 100.0 * r[key].get<double>(); };
    fmt::print(
        "{:<30} {:>6} | {:>6.2f} {:>6.2f} {:>6.2f} {:>6.2f} | {:>6.2f} {:>6.2f} | {:>4.0f} "
        "{:>4.0f} | "
        "{:>5.1f} {:>5.1f} {:>5.1f} | {:>5.1f}\n",
        series.name, series.wall.size(), r["wall_ms"]["p50"].get<double>(),
        r["wall_ms"]["p90"].get<double>(), r["wall_ms"]["p99"].get<double>(),
        r["wall_ms"]["max"].get<double>(), r["cpu_ms"]["p50"].get<double>(),
        r["cpu_ms"]["p99"].get<double>(), r["iterations"]["p50"].get<double>(),
        r["iterations"]["p99"].get<double>(), percent("converged"), percent("deadline"),
        percent("fallback"), r["joints_asked"].get<double>());
  }
  fmt::print("\nSolve times, number per millisecond (the last: 15 and more)\n");
  for (const Series& series : all) {
    fmt::print("{:<30}", series.name);
    const nlohmann::json r = report(series);
    for (const auto& bin : r["histogram_ms"]) fmt::print(" {:>4}", bin.get<int>());
    fmt::print("\n");
  }
  fmt::print("\nThe programme's own part, CPU\n");
  for (const auto& [name, time] : parts) fmt::print("{:<30} {:>6.1f} us\n", name, 1e6 * time);
  return 0;
}
