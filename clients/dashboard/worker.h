#pragma once

#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include "clients/dashboard/http.h"

/// The thread on which HTTP handlers run: they may read files and databases, and take their time.
namespace secondskin::dashboard {

class Worker {
 public:
  explicit Worker(std::vector<HttpHandler> handlers) : handlers_(std::move(handlers)) {}

  void start();
  void stop();  ///< what waits is never answered

  /// Any thread. @param reply  called on the worker's thread
  void answer(HttpRequest request, std::function<void(HttpResponse)> reply);

 private:
  HttpResponse handle(const HttpRequest& request) const;

  struct Job {
    HttpRequest request;
    std::function<void(HttpResponse)> reply;
  };
  std::vector<HttpHandler> handlers_;
  std::mutex mutex_;
  std::condition_variable_any news_;
  std::deque<Job> jobs_;
  std::jthread thread_;
};

}  // namespace secondskin::dashboard
