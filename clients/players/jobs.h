#pragma once

#include <condition_variable>
#include <deque>
#include <filesystem>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>

/// Long work on files, one at a time, on a thread of low priority, so that a live session is not
/// slowed and other requests are answered. Its results are kept as files until there are too many.
namespace secondskin::players {

struct JobStatus {
  enum class State : std::uint8_t { kWaiting, kRunning, kDone, kFailed };
  State state = State::kWaiting;
  double progress = 0.0;       ///< 0 to 1
  std::string error;           ///< of a failed one
  bool may_pass = false;       ///< of a failed one: the disk refused, another time it may not
  std::string note;            ///< what a finished one wants to say, JSON; may be empty
  std::filesystem::path file;  ///< of a finished one that wrote any
};

class Jobs {
 public:
  /// Writes its result into `part`, if it has one. @returns the note. Throws what the status is to
  /// say.
  using Work =
      std::function<std::string(const std::filesystem::path& part,
                                const std::function<void(double)>& progress, std::stop_token stop)>;

  /// @param folder  of the results; made when there is one
  /// @param most    results that are kept; the oldest go
  Jobs(std::filesystem::path folder, std::size_t most) : folder_(std::move(folder)), most_(most) {}
  ~Jobs();

  /// The job of this key; begun if there is none, anew if its file has gone. Any thread.
  /// @param key  a plain file name
  JobStatus ensure(const std::string& key, Work work);
  /// Nothing when there is none of this key. Any thread.
  std::optional<JobStatus> find(const std::string& key) const;
  /// Forgets one that is done or failed, so that ensure() begins it anew. Any thread.
  void drop(const std::string& key);

  /// While it lives no job runs.
  class Pause {
   public:
    explicit Pause(Jobs& jobs) : jobs_(jobs) {}
    ~Pause();
    Pause(const Pause&) = delete;
    Pause& operator=(const Pause&) = delete;

   private:
    Jobs& jobs_;
  };
  /// Ends the running job without a result, waits for its end, and forgets all jobs. Any thread but
  /// that of these jobs.
  [[nodiscard]] Pause pause();

 private:
  struct Entry {
    JobStatus status;
    Work work;
  };
  void run(std::stop_token stop);
  void make_room() const;

  std::filesystem::path folder_;
  std::size_t most_;
  mutable std::mutex mutex_;
  std::condition_variable_any news_;
  int pauses_ = 0;
  std::optional<std::stop_source> running_;  // to end the job that runs
  std::map<std::string, Entry> entries_;
  std::deque<std::string> waiting_;
  std::jthread thread_;  // begun with the first job
};

}  // namespace secondskin::players
