#include <execinfo.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <thread>

#include "bus/pose_messages.h"
#include "clients/tactor_driver/driver_core.h"
#include "coach/coach_messages.h"
#include "tests/coach_align/trials.h"

// Eigen calls malloc itself, so malloc is what must be counted. The sanitizers bring their own.
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define COUNTS_MALLOC 1

namespace {

// Of the thread that the live path runs on; the solver beside it may allocate.
thread_local bool counting = false;
thread_local long allocations = 0;
thread_local std::array<void*, 24> first_stack;
thread_local int first_depth = 0;

void count() noexcept {
  if (!counting) return;
  counting = false;  // backtrace() may allocate
  if (++allocations == 1) {
    first_depth = ::backtrace(first_stack.data(), static_cast<int>(first_stack.size()));
  }
  counting = true;
}

/// Counts what happens while it lives, and says where the first one was.
class Counting {
 public:
  Counting() {
    allocations = 0;
    counting = true;
  }
  ~Counting() { counting = false; }
  static void say_where() {
    if (allocations > 0) ::backtrace_symbols_fd(first_stack.data(), first_depth, STDERR_FILENO);
  }
};

}  // namespace

extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_realloc(void*, std::size_t);
void* __libc_memalign(std::size_t, std::size_t);

void* malloc(std::size_t size) {
  count();
  return __libc_malloc(size);
}
void* calloc(std::size_t number, std::size_t size) {
  count();
  return __libc_calloc(number, size);
}
void* realloc(void* at, std::size_t size) {
  count();
  return __libc_realloc(at, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {
  count();
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** at, std::size_t alignment, std::size_t size) {
  count();
  *at = __libc_memalign(alignment, size);
  return *at == nullptr ? ENOMEM : 0;
}
}
#endif

namespace secondskin::coach {
namespace {

namespace msg = bus::msg;

#ifdef COUNTS_MALLOC

/// A port that takes what it is given.
class OpenPort final : public wire::ByteLink {
 public:
  std::size_t write_some(std::span<const std::uint8_t> bytes) noexcept override {
    bytes_ += bytes.size();
    return bytes.size();
  }
  std::size_t read_some(std::span<std::uint8_t>) noexcept override { return 0; }
  bool connected() const noexcept override { return true; }
  std::size_t bytes() const { return bytes_; }

 private:
  std::size_t bytes_ = 0;
};

/// What coach service and tactor driver do to a pose, between the topics.
struct LivePath {
  LivePath(std::shared_ptr<const Reference> reference, const Skeleton& body)
      : solver(reference, body, {.tolerance_scale = kSettings.tolerance_scale}),
        coach(reference, BodyMap::load(SECONDSKIN_SOURCE_DIR "/body_maps/full_body.toml"),
              kSettings, solver) {
    driver.link_up(0.0);
  }

  void step(const msg::SkeletonPose& message) {
    poses += bus::from_message(message, pose) ? 1 : 0;
    coach.step(pose, out);
    to_message(pose, out.tactors, ++number, command);
    to_message(pose, out.alignment, alignment);
    to_message(pose, out, coach.tolerance(), correction);
    if (out.repetition) {
      to_message(pose, *out.repetition, score);
      ++repetitions;
    }
    if (out.handed_over) ++corrections;
    coach.pose_problem();

    const double now = static_cast<double>(pose.stamp_ns - stamp(0.0)) * 1e-9;
    newest.intensities = command.intensities();
    newest.stamp_ns = command.header().stamp_ns();
    newest.valid_for = static_cast<double>(command.valid_for_ns()) * 1e-9;
    newest.number = command.command_number();
    (void)driver.push(newest, now);
    driver.pump(now, port);
    driver.pump(now + 0.005, port);
  }

  static constexpr CoachSettings kSettings{.tolerance_scale = 0.2, .max_cues = 4};
  SolverThread solver;
  Coach coach;
  tactor_driver::DriverCore driver;
  OpenPort port;
  StampedPose pose;
  CoachOutput out;
  msg::TactorCommand command;
  msg::Alignment alignment;
  msg::Correction correction;
  msg::RepetitionScore score;
  tactor_driver::DriverCommand newest;
  std::uint64_t number = 0;
  std::size_t poses = 0, corrections = 0, repetitions = 0;
};

#endif

TEST(Counting, SeesAnAllocation) {
#ifdef COUNTS_MALLOC
  {
    const Counting here;
    void* volatile plain = std::malloc(8);  // volatile: or the compiler leaves them out
    int* volatile number = new int(3);
    const Eigen::VectorXd vector = Eigen::VectorXd::Constant(*number + 9, 1.0);
    std::free(plain);
    delete number;
    EXPECT_EQ(vector.sum(), 12.0);
  }
  EXPECT_EQ(allocations, 3);
#else
  GTEST_SKIP() << "the sanitizers replace malloc";
#endif
}

// The steady-state path from a sample to a tactor byte, with Ipopt at work beside it.
TEST(LivePath, AllocatesNothingFromPoseToByte) {
#ifdef COUNTS_MALLOC
  std::array<void*, 4> warm;
  (void)::backtrace(warm.data(), static_cast<int>(warm.size()));  // loads its library

  const Motion learner = resample(shipped_learner("low_block"), kLearnerRate);
  LivePath path(shipped("low_block"), learner.skeleton);
  msg::SkeletonPose message;
  StampedPose sample;
  const std::size_t count = learner.poses.size();
  long counted = 0;
  std::size_t warm_corrections = 0, warm_repetitions = 0, warm_bytes = 0;
  // The first time round warms up; the second counts, leap from the last pose to the first
  // included.
  for (std::size_t i = 0; i < 2 * count; ++i) {
    if (i == count) {
      warm_corrections = path.corrections;
      warm_repetitions = path.repetitions;
      warm_bytes = path.port.bytes();
    }
    sample.frame = i + 1;
    sample.stamp_ns = stamp(static_cast<double>(i) / kLearnerRate);
    sample.pose = learner.poses[i % count];
    bus::to_message(sample, 1, message);
    if (i < count) {
      path.step(message);
    } else {
      const Counting here;
      path.step(message);
    }
    if (i >= count) {
      counted += allocations;
      if (allocations > 0) {
        Counting::say_where();
        FAIL() << allocations << " allocations at frame " << i
               << "; the first one's stack is above";
      }
    }
    // Eight times as fast as life: time enough for the solver to take its part.
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  EXPECT_EQ(counted, 0);
  // It was alive: poses followed, results handed over, repetitions scored, bytes sent.
  EXPECT_EQ(path.poses, 2 * count);
  EXPECT_GT(path.corrections, warm_corrections + 50);
  EXPECT_GT(path.repetitions, warm_repetitions);
  EXPECT_GT(path.port.bytes(), warm_bytes + 500);
#else
  GTEST_SKIP() << "the sanitizers replace malloc";
#endif
}

}  // namespace
}  // namespace secondskin::coach
