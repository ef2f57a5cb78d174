#include "clients/players/jobs.h"

#include <spdlog/spdlog.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <system_error>
#include <utility>
#include <vector>

namespace secondskin::players {
namespace {

namespace fs = std::filesystem;

constexpr int kNiceness = 15;

}  // namespace

Jobs::~Jobs() {
  thread_.request_stop();
  if (thread_.joinable()) thread_.join();
}

JobStatus Jobs::ensure(const std::string& key, Work work) {
  const std::lock_guard lock(mutex_);
  auto& entry = entries_[key];
  using State = JobStatus::State;
  std::error_code error;
  const bool fresh = entry.status.state == State::kWaiting && !entry.work;
  const bool gone = entry.status.state == State::kDone && !entry.status.file.empty() &&
                    !fs::exists(entry.status.file, error);
  if (fresh || gone) {
    entry = {{}, std::move(work)};
    waiting_.push_back(key);
    if (!thread_.joinable()) thread_ = std::jthread([this](std::stop_token stop) { run(stop); });
    news_.notify_one();
  }
  return entry.status;
}

std::optional<JobStatus> Jobs::find(const std::string& key) const {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(key);
  return found == entries_.end() ? std::nullopt : std::optional(found->second.status);
}

void Jobs::drop(const std::string& key) {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(key);
  if (found == entries_.end()) return;
  const auto state = found->second.status.state;
  if (state == JobStatus::State::kDone || state == JobStatus::State::kFailed) {
    entries_.erase(found);
  }
}

Jobs::Pause Jobs::pause() {
  std::unique_lock lock(mutex_);
  ++pauses_;
  if (running_) running_->request_stop();
  news_.wait(lock, [this] { return !running_; });
  entries_.clear();
  waiting_.clear();
  return Pause(*this);
}

Jobs::Pause::~Pause() {
  {
    const std::lock_guard lock(jobs_.mutex_);
    --jobs_.pauses_;
  }
  jobs_.news_.notify_all();
}

void Jobs::run(std::stop_token stop) {
  // Of this thread alone: what is looked at waits for what is felt.
  ::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), kNiceness);
  for (;;) {
    std::unique_lock lock(mutex_);
    if (!news_.wait(lock, stop, [this] { return !waiting_.empty() && pauses_ == 0; })) return;
    const std::string key = std::move(waiting_.front());
    waiting_.pop_front();
    Entry& entry = entries_.at(key);  // while it runs it stays where it is
    entry.status.state = JobStatus::State::kRunning;
    std::stop_source end;
    running_ = end;
    const std::stop_callback link(stop, [&end] { end.request_stop(); });
    const Work work = std::move(entry.work);
    entry.work = nullptr;
    lock.unlock();

    const fs::path file = folder_ / (key + ".mcap"), part = folder_ / (key + ".part");
    std::string note, failure;
    bool may_pass = false, has_file = false;
    try {
      fs::create_directories(folder_);
      make_room();
      fs::remove(part);
      const auto progress = [&](double share) {
        const std::lock_guard guard(mutex_);
        entry.status.progress = std::clamp(share, 0.0, 1.0);
      };
      note = work(part, progress, end.get_token());
      has_file = fs::exists(part);
      if (has_file) fs::rename(part, file);
    } catch (const std::exception& error) {
      std::error_code ignored;
      fs::remove(part, ignored);
      failure = error.what();
      may_pass = dynamic_cast<const std::system_error*>(&error) != nullptr;
      spdlog::warn("recordings: {}", failure);
    }

    lock.lock();
    running_.reset();
    entry.status.state = failure.empty() ? JobStatus::State::kDone : JobStatus::State::kFailed;
    entry.status.error = failure;
    entry.status.may_pass = may_pass;
    if (failure.empty()) {
      entry.status.progress = 1.0;
      entry.status.note = note;
      if (has_file) entry.status.file = file;
    }
    lock.unlock();
    news_.notify_all();
  }
}

void Jobs::make_room() const {
  std::vector<std::pair<fs::file_time_type, fs::path>> results;
  for (const auto& entry : fs::directory_iterator(folder_)) {
    if (entry.path().extension() == ".mcap") {
      results.emplace_back(entry.last_write_time(), entry.path());
    }
  }
  if (results.size() < most_) return;
  std::sort(results.begin(), results.end());
  for (std::size_t i = 0; i + most_ <= results.size(); ++i) fs::remove(results[i].second);
}

}  // namespace secondskin::players
