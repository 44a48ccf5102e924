//! The application for a board with a power stage: the current tick with the haptic tick in it, the serial line, the
//! desk and the slow work. What the gate driver's fault line does, above all of these, is the board's.

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use firmware::board::{Housekeeping, PowerStage, SerialOutput};
    use firmware::current_tick::{self, CurrentTick};
    use firmware::desk::{Desk, Identity};
    use firmware::settings::{self, BoardKind};
    use firmware::store::Keep;
    use firmware::ticker::Ticker;
    use firmware::upkeep::{PERIODS, Upkeep};
    use firmware::{Commands, Link, Measurements, Moves, Records};
    use heapless::spsc::{Consumer, Producer, Queue};
    use stm32f4xx_hal::pac::Interrupt;

    use crate::board::{self, Board, Housekeeper, Rest, SerialIn, SerialOut, Stage, Storage};

    /// Bytes from the host that the desk has not read yet.
    type Bytes = Queue<u8, BYTES>;
    const BYTES: usize = 512;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        rest: Rest,
        stage: Stage,
        current: CurrentTick<'static>,
        slow_in: u32,
        housekeeper: Housekeeper,
        upkeep: Upkeep<'static>,
        serial_in: SerialIn,
        received: Producer<'static, u8, BYTES>,
        bytes: Consumer<'static, u8, BYTES>,
        serial_out: SerialOut,
        desk: Desk<'static, Storage>,
    }

    #[init(local = [
        byte_queue: Bytes = Queue::new(),
        commands: Commands = Queue::new(),
        records: Records = Queue::new(),
        measurements: Measurements = Queue::new(),
        moves: Moves = Queue::new(),
        link: Link = Link::new(),
    ])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let Board {
            mut stage,
            housekeeper,
            serial_in,
            serial_out,
            mut storage,
            rest,
        } = board::set_up(cx.device);
        let link: &'static Link = cx.local.link;
        let (received, bytes) = cx.local.byte_queue.split();
        let (command_sender, command_receiver) = cx.local.commands.split();
        let (record_sender, record_receiver) = cx.local.records.split();
        let (measurement_sender, measurement_receiver) = cx.local.measurements.split();
        let (move_sender, move_receiver) = cx.local.moves.split();
        let identity = Identity {
            firmware: env!("CARGO_PKG_VERSION"),
            git_hash: env!("GIT_HASH"),
            board: board::NAME,
            kind: BoardKind::Stage(stage.facts()),
            reset: housekeeper.reset_reason(),
        };
        // The defaults are tested natively to settle; a board that cannot run them must not run.
        let Ok(start) = settings::start(&storage.load(), &identity.kind) else {
            panic!("the default parameters are refused");
        };
        let Some(power) = start.settled.power else {
            panic!("a power stage without settings for it");
        };
        let counter = stage.sensed().counter;
        let ticker = Ticker::new(
            &start.settled,
            current_tick::widened(counter, Stage::COUNTER_BITS).cast_unsigned(),
            link,
            command_receiver,
            record_sender,
            move_sender,
        );
        let current = CurrentTick::new(
            ticker,
            power,
            Stage::COUNTER_BITS,
            counter,
            measurement_sender,
        );
        let desk = Desk::new(
            identity,
            &start,
            storage,
            link,
            command_sender,
            record_receiver,
            move_receiver,
        )
        .told(measurement_receiver);
        defmt::info!(
            "knob {=str} ({=str}) on {=str}",
            identity.firmware,
            identity.git_hash,
            identity.board
        );
        (
            Shared {},
            Local {
                rest,
                stage,
                current,
                slow_in: PERIODS,
                housekeeper,
                upkeep: Upkeep::new(link),
                serial_in,
                received,
                bytes,
                serial_out,
                desk,
            },
        )
    }

    /// Everything sleeps.
    #[idle(local = [rest])]
    fn idle(cx: idle::Context) -> ! {
        loop {
            cx.local.rest.rest();
        }
    }

    /// The current tick, once in each PWM period. Highest priority of all that RTIC knows; waits for nothing.
    #[task(binds = ADC, priority = 4, local = [stage, current, slow_in])]
    fn current(cx: current::Context) {
        let start = board::stopwatch();
        let stage = cx.local.stage;
        let overran = stage.acknowledge();
        let sensed = stage.sensed();
        let gate_fault = stage.gate_fault();
        let bridge = cx.local.current.tick(&sensed, gate_fault, overran);
        stage.apply(bridge);
        if cx.local.current.was_haptic() {
            rtic::pend(Interrupt::EXTI0);
        }
        if *cx.local.slow_in <= 1 {
            *cx.local.slow_in = PERIODS;
            rtic::pend(Interrupt::EXTI1);
        } else {
            *cx.local.slow_in -= 1;
        }
        board::tick_cost(start);
    }

    /// One byte from the host.
    #[task(binds = UART4, priority = 3, local = [serial_in, received])]
    fn receive(cx: receive::Context) {
        if let Some(byte) = cx.local.serial_in.read() {
            // Where there is no room the byte is lost, the frame's checksum fails, and the host
            // asks again.
            let _ = cx.local.received.enqueue(byte);
            rtic::pend(Interrupt::EXTI0);
        }
    }

    /// What a power stage needs now and then. Above the desk, which may wait for a slow line.
    #[task(binds = EXTI1, priority = 2, local = [housekeeper, upkeep])]
    fn slow(cx: slow::Context) {
        cx.local.upkeep.run(cx.local.housekeeper);
    }

    /// Answers the host, sends what the tick has told.
    #[task(binds = EXTI0, priority = 1, local = [bytes, serial_out, desk])]
    fn desk(cx: desk::Context) {
        let (bytes, out) = (cx.local.bytes, cx.local.serial_out);
        cx.local
            .desk
            .serve(|| bytes.dequeue(), |frame| out.write(frame));
    }
}
