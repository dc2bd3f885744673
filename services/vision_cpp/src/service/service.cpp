#include "service/service.hpp"

#include <algorithm>
#include <chrono>
#include <iostream>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "service/connection.hpp"
#include "service/keys.hpp"
#include "service/robot.hpp"
#include "service/turns.hpp"

namespace armsight::vision::service {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr milliseconds kPoll{50};  // how soon a stop is seen
constexpr milliseconds kProbe{3000};

// Turns of whichever robot is next, until there are no more or `stop` is set.
void work(Turns& turns, const std::vector<std::unique_ptr<Robot>>& robots, const std::atomic<bool>& stop) {
    while (!stop) {
        if (const auto next = turns.take(steady_clock::now() + kPoll)) {
            turns.give_back(*next, robots[*next]->turn());
        }
    }
}

// As many threads as there are processors measure, this one among them: more would only wait for each other.
void serve(Turns& turns, const std::vector<std::unique_ptr<Robot>>& robots, const std::atomic<bool>& stop) {
    const std::size_t processors = std::max(1U, std::thread::hardware_concurrency());
    std::vector<std::jthread> others;
    for (std::size_t i = 1; i < std::min(processors, robots.size()); ++i) {
        others.emplace_back([&] { work(turns, robots, stop); });
    }
    work(turns, robots, stop);
}

}  // namespace

int run(const Settings& settings, const std::atomic<bool>& stop) {
    Turns turns(settings.robots.size());
    std::vector<std::unique_ptr<Robot>> robots;
    for (const std::string& name : settings.robots) {
        auto connection = connect(settings, name, settings.shared_memory, stop);
        if (!connection) return 0;
        robots.push_back(std::make_unique<Robot>(std::move(*connection), settings,
                                                 [&turns, robot = robots.size()] { turns.wake(robot); }));
    }
    serve(turns, robots, stop);
    return 0;
}

int probe(const Settings& settings) {
    std::atomic<bool> late{false};
    const std::jthread timer([&late](const std::stop_token& stop) {
        for (const auto until = steady_clock::now() + kProbe; steady_clock::now() < until && !stop.stop_requested();) {
            std::this_thread::sleep_for(milliseconds{20});
        }
        late = true;
    });
    try {
        for (const std::string& name : settings.robots) {
            const auto connection = connect(settings, name, false, late);
            if (!connection) throw std::runtime_error("no router within 3 s");
            std::string text;
            try {
                (void)connection->session.get(key_for(topics::kParametersQuery.key, "vision"), {}, kProbe);
            } catch (const zenoh::ZException& error) {
                text = connection->robot + ": " + error.what();
            }
            connection->session.close();
            if (!text.empty()) throw std::runtime_error(text);
        }
    } catch (const ConfigError&) {
        throw;
    } catch (const std::exception& error) {
        std::cerr << "vision: " << error.what() << '\n';
        return 1;
    }
    return 0;
}

}  // namespace armsight::vision::service
