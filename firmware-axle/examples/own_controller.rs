//! Image of the axle board with a kinematic controller of the user.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod law;

#[cfg(target_os = "none")]
#[embassy_executor::main]
async fn main(spawner: embassy_executor::Spawner) {
    static LAW: static_cell::StaticCell<law::Polar> = static_cell::StaticCell::new();
    let own = firmware_axle::robot::Own {
        controller: Some(LAW.init(law::Polar::default())),
        estimator: None,
    };
    firmware_axle::robot::run(spawner, own);
}

#[cfg(not(target_os = "none"))]
fn main() {}
