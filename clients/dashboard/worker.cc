#include "clients/dashboard/worker.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "clients/dashboard/json_answer.h"

namespace secondskin::dashboard {

void Worker::start() {
  thread_ = std::jthread([this](std::stop_token stop) {
    for (;;) {
      std::unique_lock lock(mutex_);
      if (!news_.wait(lock, stop, [this] { return !jobs_.empty(); })) return;
      Job job = std::move(jobs_.front());
      jobs_.pop_front();
      lock.unlock();
      job.reply(handle(job.request));
    }
  });
}

void Worker::stop() {
  thread_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void Worker::answer(HttpRequest request, std::function<void(HttpResponse)> reply) {
  {
    const std::lock_guard lock(mutex_);
    jobs_.push_back({std::move(request), std::move(reply)});
  }
  news_.notify_one();
}

HttpResponse Worker::handle(const HttpRequest& request) const {
  try {
    for (const HttpHandler& handler : handlers_) {
      if (auto response = handler(request)) return std::move(*response);
    }
    return error_response(404,
                          fmt::format("{} {}: no such thing here", request.method, request.path));
  } catch (const std::exception& error) {
    spdlog::error("dashboard: {} {}: {}", request.method, request.path, error.what());
    return error_response(500, error.what());
  }
}

}  // namespace secondskin::dashboard
